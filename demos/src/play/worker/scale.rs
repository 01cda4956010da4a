//! How large the picture is drawn.

use crate::play::shared::Scale;
use catoptra_render_hybrid::MomentOptions;

/// Least share of the window's side that is drawn.
const MIN_SCALE: f32 = 0.25;

/// Shadow maps as fine as the picture: halved with every halving of its side, down to an eighth. On the CPU lane they cost
/// as much as a picture of their own size.
pub fn scaled(moments: MomentOptions, share: f32) -> MomentOptions {
    let divisor = match share {
        s if s > 0.71 => 1,
        s if s > 0.5 => 2,
        s if s > 0.36 => 4,
        _ => 8,
    };
    let part = |size: u32| (size / divisor).max(size.min(128));
    MomentOptions { size: part(moments.size), face_size: part(moments.face_size), ..moments }
}

/// Chooses the share of the window's side that is drawn, so that the frame rate holds.
pub struct ScaleController {
    share: f32,
}

impl Default for ScaleController {
    fn default() -> Self {
        // The first picture comes soon, then it grows.
        Self { share: 0.3 }
    }
}

impl ScaleController {
    /// Share of the window's side for the next picture.
    pub fn share(&self, scale: Scale) -> f32 {
        match scale {
            Scale::Hold(_) => self.share,
            Scale::Fixed(share) => share,
        }
    }

    /// Cost is about linear in pixels. Within 20% of the goal nothing changes: every change of size costs memory traffic
    /// and shows.
    pub fn learn(&mut self, scale: Scale, frame_ms: f64) {
        let Scale::Hold(rate) = scale else { return };
        let ratio = (1e3 / f64::from(rate) / frame_ms.max(0.01)) as f32;
        if (0.8..1.25).contains(&ratio) {
            return;
        }
        let wanted = self.share * ratio.sqrt();
        // A slow picture is answered at once, a fast one step by step.
        let next = wanted.min(self.share * 1.2);
        let steps = 32.0;
        self.share = ((next * steps).round() / steps).clamp(MIN_SCALE, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Milliseconds of a picture of the whole window, and where the controller settles.
    fn settle(full_ms: f64) -> f32 {
        let mut controller = ScaleController::default();
        for _ in 0..100 {
            let share = controller.share(Scale::Hold(30.0));
            controller.learn(Scale::Hold(30.0), full_ms * f64::from(share * share));
        }
        controller.share
    }

    #[test]
    fn size_follows_cost() {
        assert_eq!(settle(10.0), 1.0);
        assert_eq!(settle(1e6), MIN_SCALE);
        let share = settle(133.0);
        let ms = 133.0 * f64::from(share * share);
        assert!((20.0..45.0).contains(&ms), "{share} gives {ms} ms");
        let fixed = ScaleController::default();
        assert_eq!(fixed.share(Scale::Fixed(0.7)), 0.7);
    }
}
