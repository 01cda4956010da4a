//! The worker without a window: sizes, lanes, a renderer whose device is lost in the middle of a game.

use super::*;
use crate::{
    cli::{PictureArgs, Target},
    play::shared::{Controls, Picture, Scale},
};
use catoptra_render_hybrid::{RasterLane, Tracer, raster::testing::InjectedFault};
use std::sync::mpsc::{Receiver, channel};

const WAIT: Duration = Duration::from_secs(60);

fn cheap(raster: RasterLane) -> RendererOptions {
    RendererOptions { raster, tracer: Tracer::Cpu, ..Default::default() }
}

/// A game that stands still, so that every picture of it is the same.
fn controls(size: (u32, u32), options: RendererOptions) -> Controls {
    let target = Some(Target::Scene("two-spheres"));
    let c = Controls::new(target, &PictureArgs::default()).unwrap_or_else(|_| panic!("standard settings"));
    let settings = RenderSettings { vpl: None, ..c.settings };
    Controls { settings, window: size, scale: Scale::Fixed(1.0), paused: true, machine: options, ..c }
}

/// A worker at work.
struct Work {
    shared: Arc<Shared>,
    reports: Receiver<Report>,
    thread: Option<std::thread::JoinHandle<()>>,
    told: Vec<String>,
    machine: Option<RendererOptions>,
    failed: Option<String>,
}

impl Work {
    fn begin(
        controls: Controls,
        renderer: Renderer,
        make: impl FnMut(RendererOptions) -> Result<Renderer, Failure> + Send + 'static,
    ) -> Self {
        let (tell, reports) = channel();
        let machine = Machine { renderer, options: controls.machine, make };
        let shared = Arc::new(Shared::new(controls));
        let thread = std::thread::spawn({
            let shared = shared.clone();
            move || run(&shared, machine, &SceneOptions::default(), None, |r| tell.send(r).is_ok())
        });
        Self { shared, reports, thread: Some(thread), told: Vec::new(), machine: None, failed: None }
    }

    /// The next picture that is as large as the window; `None` where the worker gave up.
    fn picture(&mut self, size: (u32, u32)) -> Option<Picture> {
        loop {
            match self.reports.recv_timeout(WAIT).expect("the worker works") {
                Report::Picture => {
                    if let Some(p) = self.shared.take_picture().filter(|p| (p.width, p.height) == size) {
                        self.hear();
                        return Some(p);
                    }
                }
                Report::Answer => self.hear(),
                Report::Unplayable(why) => panic!("{why}"),
                Report::Failed(failure) => {
                    self.failed = Some(failure.text());
                    return None;
                }
            }
        }
    }

    /// The first picture after the worker said which machine it has; it may have made others before it was asked.
    fn picture_by(&mut self, machine: RendererOptions, size: (u32, u32)) -> Picture {
        self.machine = None;
        for _ in 0..100 {
            let p = self.picture(size).expect("the worker works");
            if self.machine.is_some() {
                assert!(self.machine == Some(machine));
                return p;
            }
        }
        panic!("the worker does not say what it has");
    }

    fn hear(&mut self) {
        for answer in self.shared.take_answers() {
            match answer {
                Answer::Told(text) => self.told.push(text),
                Answer::Machine(options) => self.machine = Some(options),
                _ => {}
            }
        }
    }
}

impl Drop for Work {
    fn drop(&mut self) {
        let mut end = self.shared.take_controls();
        end.quit = true;
        self.shared.set_controls(end);
        let ended = self.thread.take().map(std::thread::JoinHandle::join);
        assert!(std::thread::panicking() || ended.is_some_and(|r| r.is_ok()));
    }
}

#[test]
fn pictures_follow_a_window_through_odd_sizes_and_come_back_the_same() {
    let options = cheap(RasterLane::Cpu);
    let first = (64, 40);
    let c = controls(first, options);
    let mut work = Work::begin(c.clone(), Renderer::new(options).unwrap(), |_| panic!("it works"));
    let before = work.picture(first).unwrap();
    // As narrow as a pixel, prime sides, and what is left of a window that was minimised.
    for window in [(1, 1), (7, 3), (1, 97), (131, 1), (127, 61), first] {
        work.shared.set_controls(Controls { window, ..c.clone() });
        let p = work.picture(window).unwrap();
        assert_eq!(p.rgba8.len(), window.0 as usize * window.1 as usize * 4);
        assert!(p.hud.is_some());
        if window == first {
            assert!(p.rgba8 == before.rgba8, "the same picture as before");
        }
    }
}

#[test]
fn a_gpu_that_is_lost_in_a_game_is_set_up_anew_and_the_game_goes_on() {
    let (test, size) = ("a_gpu_that_is_lost_in_a_game_is_set_up_anew_and_the_game_goes_on", (64, 40));
    let options = cheap(RasterLane::Gpu);
    let Ok(mut sound) = Renderer::new(options) else {
        assert!(std::env::var_os("CI").is_none(), "CI without an adapter");
        eprintln!("SKIPPED {test}: no adapter");
        return;
    };
    let broken = move || {
        let mut renderer = Renderer::new(options).unwrap();
        renderer.gpu_mut().unwrap().inject_fault(InjectedFault::DeviceLost);
        renderer
    };
    // The picture that a sound renderer makes, with which a recovered one must agree.
    let c = controls(size, options);
    let expected = {
        let run = Run::new(Kind::TwoSpheres, 0).unwrap();
        let settings = RenderSettings { width: size.0, height: size.1, ..c.settings };
        opaque(&image_io::srgb8_from_layer(Layer::Final, &sound.render(run.scene(), &settings).unwrap().image, 0.0))
    };
    let mut work = Work::begin(c.clone(), broken(), |o| Ok(Renderer::new(o)?));
    let p = work.picture(size).expect("it goes on");
    assert!(p.rgba8 == expected, "the picture is the one of a sound device");
    assert_eq!(p.machine.lane, RasterLane::Gpu);
    assert!(work.told.iter().any(|t| t.contains("set up anew")), "{:?}", work.told);
    drop(work);
    // A device that is lost again at once is given up, in one line.
    let mut work = Work::begin(c, broken(), move |_| Ok(broken()));
    assert!(work.picture(size).is_none());
    let why = work.failed.clone().unwrap();
    assert!(why.contains("GPU failed") && !why.contains('\n'), "{why}");
}

#[test]
fn with_auto_the_game_goes_on_by_the_cpu_and_says_why() {
    let (test, size) = ("with_auto_the_game_goes_on_by_the_cpu_and_says_why", (64, 40));
    let Ok(lane) = catoptra_render_hybrid::raster::GpuRaster::new() else {
        assert!(std::env::var_os("CI").is_none(), "CI without an adapter");
        eprintln!("SKIPPED {test}: no adapter");
        return;
    };
    let options = cheap(RasterLane::Auto);
    let mut renderer = Renderer::with_gpu(options, Some(lane)).unwrap();
    renderer.gpu_mut().unwrap().inject_fault(InjectedFault::DeviceLost);
    let mut work = Work::begin(controls(size, options), renderer, |_| panic!("the renderer helps itself"));
    let p = work.picture(size).unwrap();
    assert_eq!((p.machine.lane, p.machine.tracer), (RasterLane::Cpu, Tracer::Cpu));
    let lines = p.machine.lines();
    assert!(lines.iter().any(|l| l.starts_with("the GPU failed, the CPU took over: ")), "{lines:?}");
    let mut cpu =
        Work::begin(controls(size, cheap(RasterLane::Cpu)), Renderer::new(cheap(RasterLane::Cpu)).unwrap(), |_| {
            panic!("it works")
        });
    assert!(cpu.picture(size).unwrap().rgba8 == p.rgba8, "the CPU lane's picture");
}

#[test]
fn another_lane_or_tracer_is_taken_where_it_can_be_had() {
    let size = (32, 20);
    let options = cheap(RasterLane::Cpu);
    let c = controls(size, options);
    let mut work = Work::begin(c.clone(), Renderer::new(options).unwrap(), |o| Ok(Renderer::new(o)?));
    let before = work.picture(size).unwrap();
    // The CPU's lane has no pixels for a tracer on the GPU: the old renderer stays, and says so.
    let refused = RendererOptions { tracer: Tracer::Gpu, ..options };
    let mut asks = Controls { machine: refused, ..c.clone() };
    asks.once.machine = Some(refused);
    work.shared.set_controls(asks);
    assert!(work.picture_by(options, size).rgba8 == before.rgba8);
    assert!(work.told.iter().any(|t| t.contains("--tracer gpu")), "{:?}", work.told);
    // Threads never change the picture; the renderer is another one.
    let other = RendererOptions { threads: 1, ..options };
    let mut asks = Controls { machine: other, ..c };
    asks.once.machine = Some(other);
    work.shared.set_controls(asks);
    assert!(work.picture_by(other, size).rgba8 == before.rgba8);
}
