//! The window's picture without a window: odd sizes, scales, a device that is lost.

use super::*;
use egui::{Pos2, Rect};

#[test]
fn the_stage_lies_in_the_window() {
    let rect = Rect::from_min_max(Pos2::new(100.0, 0.0), Pos2::new(400.0, 300.0));
    let stage = Stage::from_points(rect, 2.0, (800, 600));
    assert_eq!(stage, Stage { x: 200, y: 0, width: 600, height: 600 });
    let whole = Stage { x: 0, y: 0, width: 10, height: 20 };
    assert_eq!(Stage::from_points(Rect::NOTHING, 1.0, (10, 20)), whole);
    assert_eq!(Stage::from_points(Rect::EVERYTHING, 1.0, (10, 20)), whole);
    assert_eq!(Stage::from_points(rect, 1.0, (50, 20)), Stage { x: 0, y: 0, width: 50, height: 20 });
    assert_eq!(Stage::from_points(Rect::EVERYTHING, 1.0, (0, 0)).width, 1);
}
