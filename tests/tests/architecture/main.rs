//! The shape of the workspace as a test: who may import whom, what stays out of the pure parts, and how long files and
//! functions may be (ARCHITECTURE.md). A failure names the file and the line and says what to do.

mod examples;
mod imports;
mod layout;
mod purity;
mod source;

use source::{Source, workspace_sources};

/// A broken rule at a place.
pub(crate) struct Violation {
    /// File.
    pub(crate) path: String,
    /// Line, from 1.
    pub(crate) line: usize,
    /// What is wrong and what to do.
    pub(crate) message: String,
}

/// A rule reads one source file.
type Rule = fn(&Source) -> Vec<Violation>;

impl Violation {
    fn at(source: &Source, offset: usize, message: impl Into<String>) -> Self {
        Violation { path: source.path.clone(), line: source.line_at(offset), message: message.into() }
    }
}

fn report(violations: &[Violation]) {
    let lines: Vec<String> = violations.iter().map(|v| format!("{}:{}: {}", v.path, v.line, v.message)).collect();
    assert!(lines.is_empty(), "\n{}\n", lines.join("\n"));
}

fn check(rule: Rule) {
    report(&workspace_sources().iter().flat_map(rule).collect::<Vec<_>>());
}

#[test]
fn files_are_short() {
    check(layout::file_length);
}

#[test]
fn functions_are_short() {
    check(layout::function_length);
}

#[test]
fn packages_inherit_edition_and_lints() {
    report(&layout::packages());
}

#[test]
fn every_scene_is_documented() {
    report(&layout::scenes());
}

#[test]
fn packages_import_in_one_direction() {
    check(imports::packages);
    report(&imports::manifests());
}

#[test]
fn workers_are_embedded_in_one_place() {
    report(&imports::embedding(&workspace_sources()));
}

#[test]
fn render_modules_import_in_one_direction() {
    check(imports::render_modules);
}

#[test]
fn libraries_have_one_home() {
    check(purity::homes);
}

#[test]
fn render_and_schedule_are_pure() {
    check(purity::pure_parts);
}

#[test]
fn render_calls_no_platform_mathematics() {
    check(purity::platform_mathematics);
}
