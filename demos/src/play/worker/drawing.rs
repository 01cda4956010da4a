//! Pictures of what is played: the one that is shown, stills, and answers about a pixel.

use super::{
    opaque,
    playing::{Content, Playing},
    scale::scaled,
};
use crate::{
    cli::{Failure, millis},
    play::{
        overlay::Overlay,
        shared::{Answer, Controls, Hud, Machine, Picture, SaveAs, Scale},
    },
};
use catoptra_engine::RenderScene;
use catoptra_render_hybrid::{Layer, Preset, RenderError, RenderSettings, Renderer, image_io, trace::explain::RayTree};
use std::{
    path::{Path, PathBuf},
    time::Instant,
};

impl Playing {
    /// What was asked for once beside steps and actions.
    pub fn answer(&mut self, renderer: &mut Renderer, controls: &Controls) -> Vec<Answer> {
        let mut answers = Vec::new();
        if let Some([u, v]) = controls.once.explain {
            let settings = self.settings(controls, 1.0);
            let scene = self.seen(controls);
            let pixel = |share: f32, side: u32| ((share * side as f32) as u32).min(side - 1);
            let (x, y) = (pixel(u, settings.width), pixel(v, settings.height));
            answers.push(match renderer.explain(&scene, &settings, x, y) {
                Ok(tree) => {
                    let names = names(&scene, &tree);
                    Answer::Tree(tree, names)
                }
                Err(e) => Answer::Told(e.to_string()),
            });
        }
        if let Some(format) = controls.once.save {
            let told = self.save(renderer, controls, format).unwrap_or_else(|e| e.text());
            crate::cli::note(&told);
            answers.push(Answer::Told(told));
        }
        answers
    }

    /// Writes the photo at the window's size, at the high preset where that is asked for.
    fn save(&self, renderer: &mut Renderer, controls: &Controls, format: SaveAs) -> Result<String, Failure> {
        let settings = RenderSettings { keep_layers: false, ..self.settings(controls, 1.0) };
        let image = renderer.render(&self.seen(controls), &settings)?.image;
        std::fs::create_dir_all("out")?;
        let stem = format!("out/{}-photo-{:04}", self.target.name(), self.content.steps());
        let ending = if format == SaveAs::Png { "png" } else { "exr" };
        // A second photo of the same moment does not overwrite the first.
        let free =
            (0..10_000).map(|n| if n == 0 { format!("{stem}.{ending}") } else { format!("{stem}-{n}.{ending}") });
        let path =
            free.map(PathBuf::from).find(|p| !p.exists()).ok_or_else(|| Failure::other("out is full of photos"))?;
        match format {
            SaveAs::Png => {
                let srgb8 = image_io::srgb8_from_layer(Layer::Final, &image, controls.exposure_ev);
                image_io::write_png(&path, image.width, image.height, &srgb8)?;
            }
            SaveAs::Exr => image_io::write_exr(Path::new(&path), &image)?,
        }
        Ok(format!("wrote {} ({}x{})", path.display(), image.width, image.height))
    }

    /// The scene as the controls look at it.
    fn seen(&self, controls: &Controls) -> std::borrow::Cow<'_, RenderScene> {
        let scene = self.content.scene();
        match &controls.photo {
            None => std::borrow::Cow::Borrowed(scene),
            Some(photo) => {
                let mut own = scene.clone();
                own.camera = photo.camera(scene.camera.near);
                std::borrow::Cow::Owned(own)
            }
        }
    }

    /// Settings of a picture whose side is a share of the window's.
    fn settings(&self, controls: &Controls, share: f32) -> RenderSettings {
        let mut settings = controls.settings;
        if controls.photo.is_some_and(|p| p.high) {
            settings = RenderSettings::preset(Preset::High);
        }
        settings.keep_layers = controls.layer != Layer::Final;
        let side = |pixels: u32| ((pixels as f32 * share) as u32).clamp(1, 16384);
        (settings.width, settings.height) = (side(controls.window.0), side(controls.window.1));
        settings
    }

    pub fn draw(
        &mut self,
        renderer: &mut Renderer,
        controls: &Controls,
        share: f32,
        start: Instant,
    ) -> Result<Picture, RenderError> {
        let mut settings = self.settings(controls, share);
        if let Scale::Hold(_) = controls.scale {
            settings.moments = scaled(settings.moments, share);
        }
        let scene = self.seen(controls);
        let frame = renderer.render(&scene, &settings)?;
        let shown = frame.layer(controls.layer).unwrap_or(&frame.image);
        let rgba8 = opaque(&image_io::srgb8_from_layer(controls.layer, shown, controls.exposure_ev));
        let frame_ms = millis(start);
        let aspect = settings.width as f32 / settings.height as f32;
        let overlay = if controls.boxes.is_some() || controls.dots {
            Overlay::new(renderer, &scene, aspect, controls.boxes, controls.dots)
        } else {
            Overlay::default()
        };
        let hud = match &self.content {
            Content::Game(run, _) => Some(Hud::of(run.session(), run.kind(), run.number(), run.at_rest())),
            Content::Watched(_) => None,
        };
        Ok(Picture {
            width: shown.width,
            height: shown.height,
            rgba8,
            name: self.target.name(),
            frame: self.content.steps(),
            physics_ms: self.physics_ms,
            frame_ms,
            machine: Machine::of(renderer, &frame.stats),
            stats: frame.stats,
            camera: scene.camera,
            hud,
            overlay,
        })
    }
}

/// What the places of a ray tree are called: instance and material in words.
fn names(scene: &RenderScene, tree: &RayTree) -> Vec<String> {
    let name = |node: &catoptra_render_hybrid::trace::explain::RayNode| {
        let Some(m) = node.material.and_then(|m| scene.materials.get(m as usize)) else {
            return "nothing: background".into();
        };
        let kind = match m {
            m if m.unlit => "lamp".to_string(),
            m if m.mirror > 0.0 && m.mirror < 1.0 => format!("mirror {:.0}%, matte", m.mirror * 100.0),
            m if m.mirror > 0.0 => "mirror".into(),
            m if m.transmission > 0.0 => format!("glass of index {:.2}", m.ior),
            _ => "matte".into(),
        };
        format!("{kind} (instance {}, material {})", node.instance.unwrap_or(0), node.material.unwrap_or(0))
    };
    tree.nodes.iter().map(name).collect()
}
