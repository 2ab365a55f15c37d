//! Who may name whom: between packages, and between the modules of `render`.

use crate::Violation;
use crate::source::{Source, is_word_char, read};

/// Package directory, its library's name, and the packages of ours that it may name.
const PACKAGES: [(&str, &str, &[&str]); 6] = [
    ("render", "gatherlight_render", &[]),
    ("proto", "gatherlight_proto", &["gatherlight_render"]),
    ("telemetry", "gatherlight_telemetry", &[]),
    ("worker", "gatherlight_worker", &["gatherlight_proto", "gatherlight_render", "gatherlight_telemetry"]),
    (
        "coordinator",
        "gatherlight",
        &["gatherlight_proto", "gatherlight_render", "gatherlight_telemetry", "gatherlight_worker"],
    ),
    ("tests", "gatherlight_tests", &["gatherlight", "gatherlight_proto", "gatherlight_render", "gatherlight_worker"]),
];

/// Module of `render` and the modules it may name. `scene::description` is plain data that every importer fills and
/// every consumer reads; the rest of `scene` stands above materials and lights.
const RENDER_MODULES: [(&str, &[&str]); 16] = [
    ("error", &[]),
    ("settings", &["error"]),
    ("math", &[]),
    ("film", &["error", "settings", "math"]),
    ("geometry", &["error", "math"]),
    ("material", &["error", "math", "geometry", "scene::description"]),
    ("light", &["error", "math", "geometry", "material", "scene::description"]),
    ("import", &["error", "math", "geometry", "scene::description"]),
    ("scene", &["error", "settings", "math", "geometry", "material", "light", "import"]),
    ("photon", &["error", "settings", "math", "geometry", "material", "light", "scene"]),
    ("integrator", &["error", "settings", "math", "film", "geometry", "material", "light", "scene", "photon"]),
    ("export", &["error", "settings", "math", "film", "photon", "scene"]),
    ("plan", &["error", "settings", "math", "film", "geometry", "material", "light", "scene", "photon", "integrator"]),
    ("auto", &["error", "settings", "material", "scene"]),
    ("job", &["*"]),
    ("local", &["*"]),
];

/// What `render` may depend on: no async, no network, no clock, no logging.
const RENDER_DEPENDENCIES: [&str; 13] = [
    "base64",
    "blake3",
    "bytemuck",
    "exr",
    "glam",
    "image",
    "libm",
    "obvhs",
    "rayon",
    "serde",
    "serde_json",
    "thiserror",
    "zune-jpeg",
];

/// Packages name each other as ARCHITECTURE.md draws it.
pub(crate) fn packages(source: &Source) -> Vec<Violation> {
    let Some(&(package, own, allowed)) = PACKAGES.iter().find(|(p, ..)| source.path.starts_with(&format!("{p}/")))
    else {
        return Vec::new();
    };
    let others = PACKAGES.iter().map(|&(_, name, _)| name).filter(|name| *name != own && !allowed.contains(name));
    others
        .flat_map(|name| source.words(name).map(move |offset| (name, offset)))
        // `gatherlight` may also be a local name: a crate is followed by `::`.
        .filter(|&(name, offset)| source.code[offset + name.len()..].starts_with("::"))
        .map(|(name, offset)| {
            Violation::at(source, offset, format!("{package} may not import {name}: move what both need down"))
        })
        .collect()
}

/// The manifests agree with the import directions, and `render` stays free of async, network, clock and logging.
pub(crate) fn manifests() -> Vec<Violation> {
    let mut violations = Vec::new();
    for (package, own, allowed) in PACKAGES {
        let path = format!("{package}/Cargo.toml");
        for (line, name) in dependencies(&read(&path)) {
            let library = name.replace('-', "_");
            let ours = PACKAGES.iter().any(|&(_, n, _)| n == library);
            if ours && library != own && !allowed.contains(&library.as_str()) {
                let message = format!("{package} may not depend on {name}: move what both need down");
                violations.push(Violation { path: path.clone(), line, message });
            }
            if package == "render" && !ours && !RENDER_DEPENDENCIES.contains(&name.as_str()) {
                let message = format!("render may not depend on {name}: it is pure computation; see ARCHITECTURE.md");
                violations.push(Violation { path: path.clone(), line, message });
            }
        }
    }
    violations
}

/// Line and name of each entry of `[dependencies]`.
fn dependencies(manifest: &str) -> Vec<(usize, String)> {
    let mut inside = false;
    let mut found = Vec::new();
    for (index, line) in manifest.lines().enumerate() {
        if line.starts_with('[') {
            inside = line.trim() == "[dependencies]";
        } else if inside && line.contains('=') && !line.starts_with('#') {
            let name: String = line.chars().take_while(|&c| is_word_char(c) || c == '-').collect();
            found.push((index + 1, name));
        }
    }
    found
}

/// Only one file of the coordinator's library names the worker's: the one that embeds workers in this process.
pub(crate) fn embedding(sources: &[Source]) -> Vec<Violation> {
    let naming: Vec<(&Source, usize)> = sources
        .iter()
        .filter(|s| s.path.starts_with("coordinator/src/"))
        .filter_map(|s| s.words_outside_tests("gatherlight_worker").next().map(|offset| (s, offset)))
        .collect();
    naming
        .iter()
        .filter(|(s, _)| s.path != "coordinator/src/embedded.rs")
        .map(|&(s, offset)| Violation::at(s, offset, "only coordinator/src/embedded.rs may name the worker's library"))
        .collect()
}

/// Inside `render`: math ◄ geometry ◄ material, light ◄ scene ◄ photon ◄ integrator; film beside them; import and
/// export at the edges; job on top.
pub(crate) fn render_modules(source: &Source) -> Vec<Violation> {
    let Some(module) = source.path.strip_prefix("render/src/").and_then(module_of) else { return Vec::new() };
    if module == "lib" {
        return Vec::new();
    }
    let Some((_, allowed)) = RENDER_MODULES.iter().find(|(name, _)| *name == module) else {
        let message = format!("module {module} has no place yet: add it to RENDER_MODULES and to ARCHITECTURE.md");
        return vec![Violation { path: source.path.clone(), line: 1, message }];
    };
    let permitted = |name: &str| {
        allowed.iter().any(|a| *a == "*" || name == *a || name.starts_with(&format!("{a}::")))
            || name == module
            || name.starts_with(&format!("{module}::"))
    };
    let names = source.words_outside_tests("crate::").flat_map(|offset| {
        let after = &source.code[offset + "crate::".len()..];
        imported(after).into_iter().map(move |name| (offset, name))
    });
    names
        // What is not a module of the list is an item of the crate's root.
        .filter(|(_, name)| RENDER_MODULES.iter().any(|(m, _)| name.split("::").next() == Some(*m)))
        .filter(|(_, name)| !permitted(name))
        .map(|(offset, name)| {
            let message = format!("{module} may not import {name}: it stands above or beside it (ARCHITECTURE.md); move what both need down");
            Violation::at(source, offset, message)
        })
        .collect()
}

/// The first directory or file name of a path inside `render/src`.
fn module_of(path: &str) -> Option<&str> {
    path.split('/').next().map(|first| first.strip_suffix(".rs").unwrap_or(first))
}

/// The first two segments of each path that `text` (what follows `crate::`) names.
pub(crate) fn imported(text: &str) -> Vec<String> {
    let Some(group) = text.strip_prefix('{') else {
        let mut segments = text.split("::").map(|s| s.chars().take_while(|&c| is_word_char(c)).collect::<String>());
        let first = segments.next().unwrap_or_default();
        let continued = text[first.len()..].starts_with("::");
        let second = segments.next().filter(|s| continued && !s.is_empty());
        return vec![second.map_or(first.clone(), |s| format!("{first}::{s}"))];
    };
    let mut names = Vec::new();
    let mut depth = 1_usize;
    let mut begin = 0;
    for (i, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        if depth == 0 || (c == ',' && depth == 1) {
            let item = group[begin..i].trim();
            if !item.is_empty() {
                names.extend(imported(item));
            }
            begin = i + 1;
        }
        if depth == 0 {
            break;
        }
    }
    names
}
