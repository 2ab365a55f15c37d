//! Lengths, manifests and the scene list.

use crate::Violation;
use crate::source::{Source, read, root};
use std::fs;

/// Longest file in lines.
pub(crate) const MAX_FILE_LINES: usize = 500;
/// Longest function in lines.
pub(crate) const MAX_FUNCTION_LINES: usize = 70;
/// Generated code and tables of numbers, which nobody reads from top to bottom.
const LONG_FILES: [&str; 0] = [];

/// No file is longer than [`MAX_FILE_LINES`].
pub(crate) fn file_length(source: &Source) -> Vec<Violation> {
    if source.line_count <= MAX_FILE_LINES || LONG_FILES.contains(&source.path.as_str()) {
        return Vec::new();
    }
    let message = format!(
        "{} lines, over {MAX_FILE_LINES}: split it by topic, or move its tests to a file of their own",
        source.line_count
    );
    vec![Violation { path: source.path.clone(), line: source.line_count, message }]
}

/// No function is longer than [`MAX_FUNCTION_LINES`].
pub(crate) fn function_length(source: &Source) -> Vec<Violation> {
    let long = source.functions().into_iter().filter(|f| f.length > MAX_FUNCTION_LINES);
    long.map(|f| Violation {
        path: source.path.clone(),
        line: f.line,
        message: format!(
            "fn {} is {} lines, over {MAX_FUNCTION_LINES}: give its steps names and functions of their own",
            f.name, f.length
        ),
    })
    .collect()
}

/// Every package takes its edition, version, licence and lints from the workspace.
pub(crate) fn packages() -> Vec<Violation> {
    let mut violations = Vec::new();
    for package in ["coordinator", "proto", "render", "telemetry", "tests", "worker"] {
        let path = format!("{package}/Cargo.toml");
        let manifest = read(&path);
        for line in ["edition.workspace = true", "version.workspace = true", "license.workspace = true"] {
            if !manifest.lines().any(|l| l.trim() == line) {
                violations.push(Violation { path: path.clone(), line: 1, message: format!("add `{line}`") });
            }
        }
        if !manifest.contains("[lints]\nworkspace = true") {
            let message = "add `[lints]` with `workspace = true`".to_owned();
            violations.push(Violation { path, line: 1, message });
        }
    }
    violations
}

/// Every file in scenes/ is named in scenes/README.md, with its purpose and source.
pub(crate) fn scenes() -> Vec<Violation> {
    let directory = root().join("scenes");
    if !directory.is_dir() {
        return Vec::new();
    }
    let readme = read("scenes/README.md");
    let entries = fs::read_dir(&directory).unwrap_or_else(|e| panic!("{}: {e}", directory.display()));
    let names = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned());
    names
        .filter(|name| name != "README.md" && !readme.contains(name.as_str()))
        .map(|name| Violation {
            path: format!("scenes/{name}"),
            line: 1,
            message: "not in scenes/README.md: say there what it shows and where it comes from".to_owned(),
        })
        .collect()
}
