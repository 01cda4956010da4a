//! No type or trait of a dependency shows in the libraries' public surface but those that they re-export: glam, wgpu and
//! bevy's. Then an update of any other dependency is no breaking change.
//!
//! Read from rustdoc's JSON, which takes minutes to make: `cargo test -p catoptra_tests --test public_surface -- --ignored`,
//! which CI runs.

use serde_json::Value;
use std::{collections::BTreeSet, path::Path, process::Command};

/// Crates whose items may be named: the language's own, and what the libraries re-export.
const RE_EXPORTED: &[&str] = &["bevy_app", "bevy_ecs", "bevy_transform", "glam", "wgpu"];
/// Crates that stand behind those: their items are seen through a re-exported crate's own re-exports.
const BEHIND: &[&str] = &["alloc", "core", "std", "bevy_ecs_macros", "bevy_ptr", "bevy_utils", "wgpu_types"];
/// The libraries themselves.
const OWN: &[&str] = &["catoptra_engine", "catoptra_physics_lite", "catoptra_render_hybrid"];

/// Rustdoc's JSON of a library. The format is unstable, hence the switch; a folder of its own keeps other builds warm.
fn rustdoc_json(library: &str) -> Value {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folder = workspace.join("target/surface");
    let status = Command::new(env!("CARGO"))
        .args(["rustdoc", "-q", "-p", library, "--lib", "--", "-Z", "unstable-options", "--output-format", "json"])
        .current_dir(&workspace)
        .env("RUSTC_BOOTSTRAP", "1")
        .env("CARGO_TARGET_DIR", &folder)
        .status()
        .expect("cargo runs");
    assert!(status.success(), "rustdoc of {library}");
    let text = std::fs::read_to_string(folder.join("doc").join(format!("{library}.json"))).expect("rustdoc wrote it");
    serde_json::from_str(&text).expect("JSON")
}

/// Ids of all items that `value` names: types, traits, bounds.
fn named(value: &Value, out: &mut BTreeSet<String>) {
    match value {
        Value::Object(fields) => {
            // Paths are objects of `path`, `id` and `args`, wherever they stand.
            if let (Some(id), Some(_), true) = (fields.get("id"), fields.get("path"), fields.contains_key("args")) {
                out.insert(id.to_string());
            }
            fields.values().for_each(|v| named(v, out));
        }
        Value::Array(items) => items.iter().for_each(|v| named(v, out)),
        _ => {}
    }
}

/// `(item, foreign item)` for every foreign item that the library's public surface names.
fn foreign(json: &Value) -> BTreeSet<(String, String)> {
    let paths = json["paths"].as_object().expect("paths");
    let crate_of = |id: &str| paths.get(id).and_then(|p| p["path"][0].as_str()).unwrap_or_default().to_string();
    let full = |id: &str| {
        let parts = paths.get(id).and_then(|p| p["path"].as_array()).into_iter().flatten();
        parts.filter_map(Value::as_str).collect::<Vec<_>>().join("::")
    };
    let mut out = BTreeSet::new();
    for (id, item) in json["index"].as_object().expect("index") {
        if item["crate_id"] != 0 {
            continue;
        }
        let inner = item["inner"].as_object().and_then(|i| i.iter().next());
        let Some((kind, body)) = inner else { continue };
        // Re-exports are what is allowed; blanket and automatic implementations are not this library's.
        let not_ours = kind == "impl" && (!body["blanket_impl"].is_null() || body["is_synthetic"] == true);
        if kind == "use" || kind == "module" || not_ours {
            continue;
        }
        let mut ids = BTreeSet::new();
        named(body, &mut ids);
        for other in ids {
            let krate = crate_of(&other);
            if !krate.is_empty() && !RE_EXPORTED.iter().chain(BEHIND).chain(OWN).any(|c| *c == krate) {
                let name = item["name"].as_str().map_or_else(|| full(id), str::to_string);
                out.insert((format!("{kind} {name}"), full(&other)));
            }
        }
    }
    out
}

/// Names of the crates that the library's root re-exports as they are.
fn re_exports(json: &Value) -> BTreeSet<String> {
    let root = &json["index"][json["root"].to_string().as_str()];
    let items = root["inner"]["module"]["items"].as_array().expect("the root is a module");
    items
        .iter()
        .filter_map(|id| {
            let reexport = &json["index"][id.to_string().as_str()]["inner"]["use"];
            reexport["source"].as_str().filter(|s| !s.contains("::")).map(str::to_string)
        })
        .collect()
}

#[test]
#[ignore = "minutes: makes rustdoc's JSON of three libraries"]
fn no_private_dependency_shows() {
    let mut leaks = Vec::new();
    for library in OWN {
        let json = rustdoc_json(library);
        let items = json["index"].as_object().map_or(0, |i| i.len());
        assert!(items > 50, "{library} has {items} items: is the format still what this test reads?");
        let found = foreign(&json);
        println!("{library}: {items} items, {} leaks", found.len());
        leaks.extend(found.into_iter().map(|(item, other)| format!("{library}: {item} shows {other}")));
        if *library == "catoptra_render_hybrid" {
            let exported = re_exports(&json);
            for wanted in ["bevy_app", "bevy_ecs", "glam", "wgpu"] {
                assert!(exported.contains(wanted), "{wanted} is not re-exported: {exported:?}");
            }
        }
    }
    assert!(leaks.is_empty(), "{}", leaks.join("\n"));
}

#[test]
fn a_leak_would_be_found() {
    let json = serde_json::json!({
        "root": 0,
        "paths": { "7": { "path": ["rayon_core", "ThreadPool"] }, "8": { "path": ["glam", "Vec3"] }, "1": { "path": ["catoptra_engine", "f"] } },
        "index": {
            "0": { "crate_id": 0, "name": "catoptra_engine", "inner": { "module": { "items": [2] } } },
            "1": { "crate_id": 0, "name": "f", "inner": { "function": { "sig": {
                "inputs": [["pool", { "borrowed_ref": { "type": { "resolved_path": { "path": "ThreadPool", "id": 7, "args": null } } } }],
                    ["at", { "resolved_path": { "path": "Vec3", "id": 8, "args": null } }]] } } } },
            "2": { "crate_id": 0, "name": null, "inner": { "use": { "source": "glam", "name": "glam", "id": 9, "is_glob": false } } },
        },
    });
    let found: Vec<_> = foreign(&json).into_iter().collect();
    assert_eq!(found, [("function f".to_string(), "rayon_core::ThreadPool".to_string())]);
    assert!(re_exports(&json).contains("glam"));
}
