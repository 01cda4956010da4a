//! `play` in a real window: odd sizes, minimised to nothing and back, a graphics device that is lost in the middle of a game,
//! and a level won by injected keys. After each the window is photographed.
//!
//! Wants Xvfb, xdotool and ImageMagick's `import`; where one is missing the tests are skipped loudly
//! (with `CI` set they fail). The window's content is
//! drawn by whatever there is: a software driver, or the CPU.

use catoptra_render_hybrid::image_io;
use std::{
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, channel},
    time::{Duration, Instant},
};

/// A machine that builds something else meanwhile takes its time.
const WAIT: Duration = Duration::from_secs(120);

fn tools() -> Option<()> {
    let found = |tool: &str| {
        let path = std::env::var_os("PATH").unwrap_or_default();
        std::env::split_paths(&path).any(|folder| folder.join(tool).is_file())
    };
    let missing: Vec<_> = ["Xvfb", "xdotool", "import"].into_iter().filter(|t| !found(t)).collect();
    if !missing.is_empty() {
        assert!(std::env::var_os("CI").is_none(), "windows: {} missing", missing.join(", "));
        eprintln!("SKIPPED windows: {} missing", missing.join(", "));
        return None;
    }
    Some(())
}

fn folder(name: &str) -> PathBuf {
    let dir = std::env::temp_dir().join(format!("catoptra-window-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&dir);
    std::fs::create_dir_all(&dir).expect("a temporary folder");
    dir
}

/// A screen of its own with a game on it; both end with it.
struct Desk {
    screen: Child,
    game: Child,
    display: String,
    window: String,
    told: Receiver<String>,
    heard: Vec<String>,
    folder: PathBuf,
}

impl Desk {
    /// Plays `args` on a new screen of 800 x 600 pixels.
    fn open(name: &str, args: &[&str]) -> Option<Self> {
        tools()?;
        let folder = folder(name);
        // The server picks a free number and writes it.
        let mut screen = Command::new("Xvfb")
            // A server that starts anew when its only client goes would throw out the one that just came.
            .args(["-displayfd", "1", "-screen", "0", "800x600x24", "-nolisten", "tcp", "-noreset"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("Xvfb starts");
        let mut number = String::new();
        BufReader::new(screen.stdout.take().expect("it is piped"))
            .read_line(&mut number)
            .expect("Xvfb tells its number");
        let display = format!(":{}", number.trim());
        let mut game = Command::new(env!("CARGO_BIN_EXE_catoptra"))
            .arg("play")
            .args(args)
            .current_dir(&folder)
            .env("DISPLAY", &display)
            .env("XDG_RUNTIME_DIR", &folder)
            .env("CATOPTRA_CONFIG", folder.join("settings.json"))
            .env_remove("WAYLAND_DISPLAY")
            .env_remove("WAYLAND_SOCKET")
            .stderr(Stdio::piped())
            .spawn()
            .expect("the binary runs");
        let (tell, told) = channel();
        let lines = BufReader::new(game.stderr.take().expect("it is piped")).lines();
        std::thread::spawn(move || lines.map_while(Result::ok).for_each(|l| drop(tell.send(l))));
        let mut desk = Self { screen, game, display, window: String::new(), told, heard: Vec::new(), folder };
        desk.window = desk.wait("a window opens", |d| {
            let found = d.xdotool(&["search", "--name", "Catoptra"]);
            found.lines().last().map(str::to_string)
        });
        desk.xdotool(&["windowfocus", &desk.window]);
        Some(desk)
    }

    fn xdotool(&self, args: &[&str]) -> String {
        let out = Command::new("xdotool").args(args).env("DISPLAY", &self.display).output().expect("xdotool runs");
        String::from_utf8_lossy(&out.stdout).into_owned()
    }

    /// Asks until there is an answer. A game that ended has none.
    fn wait<T>(&mut self, what: &str, mut ask: impl FnMut(&mut Self) -> Option<T>) -> T {
        let start = Instant::now();
        loop {
            self.heard.extend(self.told.try_iter());
            if let Some(answer) = ask(self) {
                return answer;
            }
            if let Ok(Some(status)) = self.game.try_wait() {
                panic!("{what}: the game ended with {status}: {:?}", self.heard);
            }
            assert!(start.elapsed() < WAIT, "{what}: nothing happened; it said {:?}", self.heard);
            std::thread::sleep(Duration::from_millis(250));
        }
    }

    /// The whole screen as sRGB bytes.
    fn photo(&self) -> Vec<u8> {
        let path = self.folder.join("photo.png");
        let taken = Command::new("import")
            .args(["-window", "root", "-display", &self.display])
            .arg(format!("png24:{}", path.display()))
            .status();
        assert!(taken.expect("import runs").success());
        image_io::read_image(&path).expect("a picture").srgb8
    }

    /// A photograph in which the window of this size is filled by a lit hall; what lies outside of it is black.
    fn lit(&mut self, what: &str, (width, height): (usize, usize)) -> Vec<u8> {
        self.wait(what, |d| {
            let photo = d.photo();
            let lit = |x: usize, y: usize| photo[(y * 800 + x) * 3..][..3].iter().any(|v| *v > 12);
            let places =
                (0..20).flat_map(|i| (0..20).map(move |k| (width * (2 * i + 1) / 40, height * (2 * k + 1) / 40)));
            let share = places.filter(|(x, y)| lit(*x, *y)).count();
            (share > 340).then_some(photo)
        })
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        for child in [&mut self.game, &mut self.screen] {
            let _ = child.kill();
            let _ = child.wait();
        }
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Small and cheap, so that a busy machine shows many pictures.
const CHEAP: [&str; 6] = ["--preset", "draft", "--raster", "cpu", "--shadows", "off"];

fn size(desk: &Desk) -> (usize, usize) {
    let told = desk.xdotool(&["getwindowgeometry", "--shell", &desk.window]);
    let number = |key: &str| {
        let line = told.lines().find_map(|l| l.strip_prefix(key)).expect("xdotool tells the size");
        line.parse().expect("a number")
    };
    (number("WIDTH="), number("HEIGHT="))
}

#[test]
fn a_window_survives_odd_sizes_and_being_minimised() {
    for way in ["auto", "cpu"] {
        let args = [&["rolling-box", "--window", way], &CHEAP[..]].concat();
        let Some(mut desk) = Desk::open("sizes", &args) else { return };
        for wanted in [(641, 479), (97, 401), (1, 1), (799, 53), (640, 480)] {
            let window = desk.window.clone();
            desk.xdotool(&["windowsize", &window, &wanted.0.to_string(), &wanted.1.to_string()]);
            desk.wait("the window has its size", |d| (size(d) == wanted).then_some(()));
            if wanted.0 > 300 && wanted.1 > 300 {
                desk.lit(&format!("{wanted:?} is filled"), wanted);
            }
        }
        let window = desk.window.clone();
        // Minimised: the window is on no screen at all.
        desk.xdotool(&["windowunmap", &window]);
        desk.wait("nothing is seen", |d| d.photo().iter().all(|v| *v == 0).then_some(()));
        std::thread::sleep(Duration::from_secs(1));
        desk.xdotool(&["windowmap", &window]);
        desk.lit("it is back", (640, 480));
        assert!(!desk.heard.iter().any(|l| l.contains("panicked")), "{:?}", desk.heard);
    }
}

#[test]
fn a_device_that_is_lost_in_a_game_is_replaced_and_the_picture_is_back() {
    let args = [&["rolling-box", "--window", "gpu", "--lose-device", "5"], &CHEAP[..]].concat();
    let Some(mut desk) = Desk::open("lost", &args) else { return };
    let told = desk.wait("the loss is told", |d| d.heard.iter().find(|l| l.contains("set up anew")).cloned());
    assert!(told.contains("lost") || told.contains("failed"), "{told}");
    let whole = size(&desk);
    let before = desk.lit("the hall is lit again", (whole.0.min(800), whole.1.min(600)));
    // And it lives: a key changes the picture's counter of moves.
    let window = desk.window.clone();
    desk.xdotool(&["windowfocus", &window]);
    desk.xdotool(&["key", "--clearmodifiers", "Right"]);
    desk.wait("the box moves", |d| {
        let now = d.photo();
        let moved = now
            .chunks_exact(3)
            .zip(before.chunks_exact(3))
            .filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 60));
        (moved.count() > 2000).then_some(())
    });
}

/// The first level of a game by its solver's moves, as keys: the win is remembered in the settings.
#[test]
fn a_level_is_won_by_injected_keys() {
    use catoptra_demos::game::{Dir, Kind, Move, level, solver};
    let Some(mut desk) = Desk::open("won", &[&["rolling-box", "--size", "320x240"], &CHEAP[..]].concat()) else {
        return;
    };
    desk.lit("the game begins", (320, 240));
    let level = level(Kind::RollingBox, 0).expect("it is there");
    let solution = solver::solve(&level, &level.begin()).expect("it can be won");
    for m in &solution {
        let Move::Roll(dir) = m else { panic!("a box rolls") };
        let key = match dir {
            Dir::North => "Up",
            Dir::South => "Down",
            Dir::East => "Right",
            Dir::West => "Left",
        };
        desk.xdotool(&["key", "--clearmodifiers", key]);
        // No more than three moves wait for the box to come to rest.
        std::thread::sleep(Duration::from_millis(1500));
    }
    let settings = desk.folder.join("settings.json");
    let read = |path: &Path| {
        let text = std::fs::read_to_string(path).ok()?;
        let value: serde_json::Value = serde_json::from_str(&text).ok()?;
        value["best"]["rolling-box/1"]["moves"].as_u64()
    };
    let moves = desk.wait("the win is remembered", |_| read(&settings));
    assert_eq!(moves as usize, solution.len());
}
