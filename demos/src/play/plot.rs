//! Time of each frame by stage, as a picture: in the panel, and as an SVG file.

use super::shared::Picture;
use egui::{Color32, Pos2, Rect, Sense, Stroke, Ui, Vec2};
use std::{collections::VecDeque, path::Path};

/// Frames that the panel shows.
const SHOWN: usize = 240;
/// Frames that are kept for the file: ten minutes at 60 a second.
const KEPT: usize = 36_000;

/// Stages with their colours, bottom first.
pub const STAGES: [(&str, [u8; 3]); 8] = [
    ("physics", [130, 130, 130]),
    ("structure", [95, 160, 215]),
    ("moments", [60, 95, 170]),
    ("photons", [170, 120, 200]),
    ("G-buffer", [90, 170, 110]),
    ("direct", [235, 200, 80]),
    ("indirect", [230, 130, 60]),
    ("mirrors, glass, rest", [205, 70, 80]),
];

/// Times of past frames.
#[derive(Default)]
pub struct Plot {
    frames: VecDeque<[f32; 8]>,
    /// Size of the last picture.
    size: (u32, u32),
    name: String,
}

impl Plot {
    /// Takes a picture's times over.
    pub fn learn(&mut self, p: &Picture) {
        let t = &p.stats.stages_ms;
        let known = [p.physics_ms, t.accel, t.moments, t.vpls, t.gbuffer, t.direct, t.indirect].map(|ms| ms as f32);
        let rest = (p.frame_ms as f32 - known.iter().sum::<f32>()).max(0.0);
        let mut frame = [rest; 8];
        frame[..7].copy_from_slice(&known);
        self.frames.push_back(frame);
        if self.frames.len() > KEPT {
            self.frames.pop_front();
        }
        self.size = (p.width, p.height);
        self.name.clone_from(&p.name);
    }

    /// Begins again.
    pub fn clear(&mut self) {
        self.frames.clear();
    }

    /// (frames, median, greatest) in milliseconds.
    pub fn figures(&self) -> (usize, f32, f32) {
        let mut totals: Vec<f32> = self.frames.iter().map(|f| f.iter().sum()).collect();
        totals.sort_by(f32::total_cmp);
        let (n, median) = (totals.len(), totals.get(totals.len() / 2).copied().unwrap_or(0.0));
        (n, median, totals.last().copied().unwrap_or(0.0))
    }

    /// Draws the last frames.
    pub fn ui(&self, ui: &mut Ui) {
        let (response, painter) = ui.allocate_painter(Vec2::new(ui.available_width(), 90.0), Sense::hover());
        let rect = response.rect;
        painter.rect_filled(rect, 2.0, Color32::from_gray(20));
        let shown: Vec<&[f32; 8]> = self.frames.iter().rev().take(SHOWN).collect();
        let most = shown.iter().map(|f| f.iter().sum::<f32>()).fold(1.0, f32::max);
        let width = rect.width() / SHOWN as f32;
        for (i, frame) in shown.iter().enumerate() {
            let right = rect.right() - i as f32 * width;
            let mut y = rect.bottom();
            for (ms, (_, [r, g, b])) in frame.iter().zip(STAGES) {
                let top = y - ms / most * (rect.height() - 2.0);
                let bar = Rect::from_min_max(Pos2::new(right - width, top), Pos2::new(right, y));
                painter.rect_filled(bar, 0.0, Color32::from_rgb(r, g, b));
                y = top;
            }
        }
        let median = self.figures().1;
        let y = rect.bottom() - median / most * (rect.height() - 2.0);
        painter.hline(rect.x_range(), y, Stroke::new(1.0, Color32::WHITE));
        ui.label(format!("top {most:.0} ms, line: median {median:.1} ms"));
        ui.horizontal_wrapped(|ui| {
            for (name, [r, g, b]) in STAGES {
                ui.colored_label(Color32::from_rgb(r, g, b), name);
            }
        });
    }

    /// Writes all frames that are kept, with median and three times the median as lines.
    ///
    /// # Errors
    /// In words.
    pub fn write_svg(&self, path: &Path) -> Result<(), String> {
        std::fs::write(path, self.svg()).map_err(|e| format!("cannot write {}: {e}", path.display()))
    }

    fn svg(&self) -> String {
        use std::fmt::Write;
        let (n, median, greatest) = self.figures();
        let (width, height, left, top) = (1000.0, 320.0, 60.0, 40.0);
        let scale = height / (3.2 * median).max(greatest).max(1e-3);
        let x = |i: f32| left + i * width / n.max(1) as f32;
        let mut s = String::new();
        // Writing to a string cannot fail.
        let _ = write!(
            s,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 1080 440\" font-family=\"sans-serif\" font-size=\"14\">\
             <rect width=\"1080\" height=\"440\" fill=\"#fff\"/><text x=\"{left}\" y=\"24\">{}: {n} frames of {}x{}, median \
             {median:.1} ms, greatest {greatest:.1} ms</text>",
            self.name, self.size.0, self.size.1
        );
        // One column a frame, or the dearest frame of each column where there are more than pixels.
        let columns = n.min(1000);
        let mut bottom = vec![0.0f32; columns];
        let pick: Vec<&[f32; 8]> = (0..columns)
            .map(|c| {
                let run = c * n / columns..((c + 1) * n / columns).max(c * n / columns + 1);
                let dearest = run.max_by(|a, b| {
                    let total = |i: &usize| self.frames[*i].iter().sum::<f32>();
                    total(a).total_cmp(&total(b))
                });
                &self.frames[dearest.unwrap_or(0)]
            })
            .collect();
        let at = |c: usize| x((c as f32 + 0.5) * n as f32 / columns.max(1) as f32);
        for (stage, (name, [r, g, b])) in STAGES.into_iter().enumerate() {
            let mut points = String::new();
            let before = bottom.clone();
            for (c, frame) in pick.iter().enumerate() {
                bottom[c] += frame[stage];
                let _ = write!(points, "{:.1},{:.1} ", at(c), top + height - bottom[c] * scale);
            }
            for (c, base) in before.iter().enumerate().rev() {
                let _ = write!(points, "{:.1},{:.1} ", at(c), top + height - base * scale);
            }
            let fill = format!("#{r:02x}{g:02x}{b:02x}");
            let _ = write!(s, "<polygon points=\"{points}\" fill=\"{fill}\"/>");
            let place = left + stage as f32 * 122.0;
            let _ = write!(s, "<rect x=\"{place}\" y=\"395\" width=\"12\" height=\"12\" fill=\"{fill}\"/>");
            let _ = write!(s, "<text x=\"{}\" y=\"406\" font-size=\"12\">{name}</text>", place + 16.0);
        }
        for (factor, dash) in [(1.0, "1 0"), (3.0, "6 4")] {
            let y = top + height - factor * median * scale;
            let _ = write!(
                s,
                "<line x1=\"{left}\" x2=\"{}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"#000\" stroke-dasharray=\"{dash}\"/>\
                 <text x=\"4\" y=\"{:.1}\" font-size=\"11\">{:.0} ms</text>",
                left + width,
                y + 4.0,
                factor * median
            );
        }
        s.push_str("</svg>\n");
        s
    }
}
