//! The screen by accessible names: what a player finds, and what happens when he presses it.

pub mod snapshots;

use super::*;
use crate::{
    cli::{PictureArgs, Target},
    game::Kind,
    play::shared::SaveAs,
};
use catoptra_render_hybrid::trace::explain::{RayKind, RayNode};
use egui::{Color32, Pos2};
use egui_kittest::{Harness, kittest::Queryable};
use glam::Vec3;

struct Model {
    shell: Shell,
    controls: Controls,
    wishes: Wishes,
}

fn hud(won: Option<u32>) -> Hud {
    Hud {
        kind: Kind::RollingBox,
        level: (0, 4),
        name: "First steps".into(),
        moves: (10, 10),
        can_undo: true,
        message: String::new(),
        won,
        putter: None,
    }
}

fn model(target: Option<&'static str>) -> Model {
    let target = target.map(Target::Scene);
    let controls = Controls::new(target, &PictureArgs::default()).unwrap_or_else(|_| panic!("standard settings"));
    Model { shell: Shell::new(Settings::default(), String::new()), controls, wishes: Wishes::default() }
}

fn harness(model: Model) -> Harness<'static, Model> {
    let show = |ui: &mut Ui, m: &mut Model| {
        let wishes = ui_of(ui, m);
        if wishes != Wishes::default() {
            m.wishes = wishes;
        }
    };
    let mut harness = Harness::builder().with_size([1280.0, 1700.0]).build_ui_state(show, model);
    harness.run();
    harness
}

fn ui_of(ui: &mut Ui, m: &mut Model) -> Wishes {
    super::ui(ui, &mut m.shell, &mut m.controls)
}

fn click(harness: &mut Harness<'_, Model>, name: &str) {
    harness.get_by_label(name).click();
    harness.run();
}

#[test]
fn the_picker_offers_five_games_and_starts_the_one_that_is_clicked() {
    for kind in Kind::ALL {
        let mut harness = harness(model(None));
        for other in Kind::ALL {
            harness.get_by_role_and_label(egui::Role::Button, other.title());
            harness.get_by_label(other.goal());
        }
        harness.get_by_role_and_label(egui::Role::Button, kind.title()).click();
        harness.run();
        assert_eq!(harness.state().controls.target, Some(Target::Scene(kind.name())));
    }
}

#[test]
fn the_win_screen_tells_the_result_and_leads_on() {
    for (button, action) in
        [("Next level", Some(Action::Level(1))), ("Play again", Some(Action::Restart)), ("All games", None)]
    {
        let mut m = model(Some("rolling-box"));
        m.shell.hud = Some(hud(Some(3)));
        let mut harness = harness(m);
        harness.get_by_label("3 of 3 stars");
        harness.get_by_label("First steps: 10 moves, par 10");
        click(&mut harness, button);
        let controls = &harness.state().controls;
        assert_eq!(controls.once.actions, Vec::from_iter(action), "{button}");
        assert_eq!(controls.target.is_none(), action.is_none());
        assert!(harness.query_by_label("3 of 3 stars").is_none(), "the win screen is gone");
    }
}

#[test]
fn the_display_shows_goal_moves_and_par_and_its_buttons_act() {
    let mut m = model(Some("rolling-box"));
    m.shell.hud = Some(hud(None));
    let mut harness = harness(m);
    harness.get_by_label("Moves 10   Par 10");
    // Goal and advice make room for the mirrors after the first move, and come back where one points at the title.
    assert!(harness.query_by_label(Kind::RollingBox.goal()).is_none());
    harness.hover_at(Pos2::new(30.0, 25.0));
    harness.run();
    harness.get_by_label(Kind::RollingBox.goal());
    harness.remove_cursor();
    harness.state_mut().shell.hud = Some(Hud { moves: (0, 10), ..hud(None) });
    harness.run();
    harness.get_by_label(Kind::RollingBox.goal());
    harness.get_by_label(Kind::RollingBox.look());
    assert!(harness.query_by_label("Next level").is_none(), "nothing is won yet");
    for name in ["Undo", "Restart", "Hint", "Level 3"] {
        click(&mut harness, name);
    }
    let wanted = vec![Action::Undo, Action::Restart, Action::Hint, Action::Level(2)];
    assert_eq!(harness.state().controls.once.actions, wanted);
}

#[test]
fn keys_act_by_their_commands() {
    let mut m = model(Some("two-spheres"));
    m.shell.hud = Some(Hud { putter: Some((0, 5)), ..hud(None) });
    for command in [Command::West, Command::West, Command::North, Command::South, Command::Strike] {
        m.shell.command(command, &mut m.controls);
    }
    // A picture that was made before the keys were pressed does not set them back.
    m.shell.learn(&Some(Hud { putter: Some((0, 5)), ..hud(None) }));
    m.shell.command(Command::West, &mut m.controls);
    assert_eq!(m.controls.once.actions.pop(), Some(Action::Aim(61)));
    let wanted = vec![Action::Aim(63), Action::Aim(62), Action::Power(4), Action::Putt];
    assert_eq!(m.controls.once.actions, wanted, "aims count on, and strength ends at its most");
    m.shell.command(Command::Pause, &mut m.controls);
    assert!(m.controls.paused && m.shell.menu == Some(Menu::Pause));
    m.shell.command(Command::Strike, &mut m.controls);
    assert_eq!(m.controls.once.actions.len(), 4, "nothing is struck behind a menu");
}

#[test]
fn the_panel_switches_stages_presets_views_and_overlays() {
    let mut m = model(Some("rolling-box-donut"));
    m.shell.settings.panel = true;
    let mut harness = harness(m);
    assert!(harness.state().controls.settings.traced && harness.state().controls.settings.vpl.is_some());
    for name in ["mirrors and glass", "indirect light", "boxes of the BVH", "VPLs as dots", "explain a pixel"] {
        click(&mut harness, name);
    }
    let state = harness.state();
    assert!(!state.controls.settings.traced && state.controls.settings.vpl.is_none());
    assert!(state.controls.boxes == Some(0) && state.controls.dots && state.shell.explaining);
    click(&mut harness, "draft");
    assert_eq!(harness.state().controls.settings.max_depth, 4);
    click(&mut harness, "screenshot");
    assert!(harness.state().wishes.screenshot);
    click(&mut harness, "save plot");
    assert!(harness.state().wishes.save_plot);
}

#[test]
fn a_click_on_the_picture_plays_or_asks() {
    for explaining in [false, true] {
        let mut m = model(Some("rolling-box"));
        m.shell.hud = Some(hud(None));
        m.shell.explaining = explaining;
        let mut harness = harness(m);
        let at = Pos2::new(320.0, 450.0);
        harness.hover_at(at);
        harness.drag_at(at);
        harness.drop_at(at);
        harness.run();
        let once = &harness.state().controls.once;
        let stage = harness.state().shell.stage;
        let place = [(at.x - stage.left()) / stage.width(), (at.y - stage.top()) / stage.height()];
        assert_eq!(once.clicks, if explaining { vec![] } else { vec![place] });
        assert_eq!(once.explain, explaining.then_some(place));
    }
}

/// A ray into glass and its two branches; `second` is what the reflected one meets.
fn tree(second: &str) -> (RayTree, Vec<String>) {
    let node = |kind, parent, split: f32, distance, added| RayNode {
        kind,
        parent,
        depth: u32::from(parent.is_some()),
        split: Vec3::splat(split),
        weight: Vec3::splat(split),
        distance,
        instance: Some(2),
        material: Some(1),
        direct: Vec3::ONE,
        indirect: Vec3::ZERO,
        added: Vec3::splat(added),
    };
    let nodes = vec![
        node(RayKind::Camera, None, 1.0, 2.5, 0.0),
        node(RayKind::Reflection, Some(0), 0.02, 1.25, 0.02),
        node(RayKind::Refraction, Some(0), 0.96, f32::INFINITY, 0.48),
    ];
    let names = ["glass of index 1.33", second, "nothing: background"].map(String::from).to_vec();
    (RayTree { pixel: (3, 4), nodes, cut: false }, names)
}

#[test]
fn the_pixel_explainer_names_every_branch() {
    let mut m = model(Some("rolling-box-donut"));
    m.shell.tree = Some(tree("matte"));
    let mut harness = harness(m);
    harness.get_by_label("pixel 3, 4: radiance (0.500, 0.500, 0.500)");
    harness.get_by_label("3 rays; what they add is the pixel");
    harness.get_by_label("eye 2.50 m to glass of index 1.33: adds (0.000, 0.000, 0.000)");
    harness.get_by_label("reflected 2.0% 1.25 m to matte: adds (0.020, 0.020, 0.020)");
    harness.get_by_label("through 96.0% out to nothing: background: adds (0.480, 0.480, 0.480)");
    harness.run();
}

#[test]
fn pause_menu_settings_and_keys() {
    let mut m = model(Some("rolling-box"));
    m.shell.hud = Some(hud(None));
    m.shell.menu = Some(Menu::Pause);
    let mut harness = harness(m);
    click(&mut harness, "Settings and keys");
    click(&mut harness, "wait for the screen (vsync)");
    let state = harness.state();
    assert!(!state.shell.settings.vsync && state.wishes.vsync && state.wishes.save_settings);
    click(&mut harness, "key of undo");
    assert_eq!(harness.state().shell.menu, Some(Menu::Settings(Some(Command::Undo))));
    click(&mut harness, "fill the screen");
    assert!(harness.state().wishes.fullscreen);
    click(&mut harness, "Back");
    click(&mut harness, "Photo mode");
    assert!(harness.state().controls.photo.is_some());
    click(&mut harness, "Save EXR");
    assert_eq!(harness.state().controls.once.save, Some(SaveAs::Exr));
    harness.state_mut().controls.exposure_ev = 2.5;
    click(&mut harness, "Back to the game");
    assert_eq!(harness.state().controls.exposure_ev, 0.0, "a photo's exposure is not the game's");
    assert!(harness.state().controls.photo.is_none() && !harness.state().controls.paused);
}

#[test]
fn the_mouse_alone_does_all_that_keys_do_in_a_game() {
    let mut m = model(Some("two-spheres"));
    m.shell.hud = Some(Hud { kind: Kind::TwoSpheres, putter: Some((7, 3)), ..hud(None) });
    let mut harness = harness(m);
    for name in ["Harder", "Harder", "Softer", "Putt", "Undo", "Hint", "Restart"] {
        click(&mut harness, name);
    }
    let wanted = [Action::Power(4), Action::Power(5), Action::Power(4), Action::Putt];
    let wanted: Vec<_> = wanted.into_iter().chain([Action::Undo, Action::Hint, Action::Restart]).collect();
    assert_eq!(harness.state().controls.once.actions, wanted);
    click(&mut harness, "Menu");
    assert!(harness.state().shell.menu == Some(Menu::Pause) && harness.state().controls.paused);
}

#[test]
fn the_panel_tells_lane_and_tracer_with_their_reasons_and_asks_for_others() {
    let mut m = model(Some("rolling-box-donut"));
    m.shell.settings.panel = true;
    m.shell.figures.learn(&snapshots::measured(1), 50.0);
    let mut harness = harness(m);
    harness.get_by_label("lane: GPU, Example GPU");
    harness.get_by_label("tracer: cpu instead of gpu (measured: gpu 1.20 ms, cpu 9.00 ms)");
    harness.get_by_label("because --tracer gpu: 40 MB of triangles, the adapter's buffers hold 16 MB");
    assert!(harness.query_by_label("try the GPU again").is_none());
    harness.get_by_role_and_label(egui::Role::ComboBox, "tracer").click();
    harness.run();
    harness.get_by_label("gpu-fragment").click();
    harness.run();
    let wanted = harness.state().controls.once.machine.expect("it is asked for");
    assert_eq!(wanted.tracer, catoptra_render_hybrid::Tracer::GpuFragment);
    // A GPU that was given up can be asked for again.
    harness.state_mut().controls.once.machine = None;
    harness.state_mut().shell.figures.machine.fault = Some("device lost".into());
    harness.run();
    harness.get_by_label("the GPU failed, the CPU took over: device lost");
    click(&mut harness, "try the GPU again");
    assert!(harness.state().controls.once.machine.is_some());
}
