//! The rules on small examples: each finds what it is for and leaves alone what is right.

use crate::imports::{imported, packages, render_modules};
use crate::layout::{MAX_FILE_LINES, MAX_FUNCTION_LINES, file_length, function_length};
use crate::purity::{homes, platform_mathematics, pure_parts};
use crate::source::Source;
use crate::{Rule, Violation};

fn lines(rule: Rule, path: &str, text: &str) -> Vec<usize> {
    rule(&Source::new(path, text)).iter().map(|v: &Violation| v.line).collect()
}

#[test]
fn comments_literals_and_lifetimes_are_no_code() {
    let text = "fn f<'a>(x: &'a str) -> char {\n    // x.sin() tokio\n    /* a /* b */ tokio */ let _ = \"tokio \\\" tokio\";\n    \
                let _ = r#\"tokio \"{\"#; '{'\n}\nfn g() { '\\'' ; tokio() }\n";
    let source = Source::new("render/src/math/x.rs", text);
    assert_eq!(source.code.len(), text.len());
    let functions = source.functions();
    let found: Vec<_> = functions.iter().map(|f| (f.name.as_str(), f.line, f.length)).collect();
    assert_eq!(found, [("f", 1, 5), ("g", 6, 1)]);
    assert_eq!(lines(pure_parts, "render/src/math/x.rs", text), [6]);
}

#[test]
fn a_function_is_measured_to_its_closing_brace() {
    let body = "    let _ = { 1 };\n";
    let at_limit = format!("fn f(\n    x: [u8; 3],\n) {{\n{}}}\n", body.repeat(MAX_FUNCTION_LINES - 4));
    assert!(lines(function_length, "a/src/x.rs", &at_limit).is_empty());
    let over = format!("\nfn f(\n    x: [u8; 3],\n) {{\n{}}}\n", body.repeat(MAX_FUNCTION_LINES - 3));
    assert_eq!(lines(function_length, "a/src/x.rs", &over), [2]);
    let declarations = format!("trait T {{\nfn f(&self, g: fn(u8) -> u8);\n{}}}\n", "const X: fn() = f;\n".repeat(100));
    assert!(lines(function_length, "a/src/x.rs", &declarations).is_empty());
}

#[test]
fn a_file_is_measured_in_lines() {
    assert!(lines(file_length, "a/src/x.rs", &"\n".repeat(MAX_FILE_LINES)).is_empty());
    assert_eq!(lines(file_length, "a/src/x.rs", &"\n".repeat(MAX_FILE_LINES + 1)), [MAX_FILE_LINES + 1]);
}

#[test]
fn packages_may_import_downwards_only() {
    let text = "use gatherlight_proto::x;\nuse gatherlight_worker::y;\nuse gatherlight::z;\nlet gatherlight = 1;\n";
    assert_eq!(lines(packages, "render/src/lib.rs", text), [1, 2, 3]);
    assert_eq!(lines(packages, "worker/src/lib.rs", text), [3]);
    assert!(lines(packages, "coordinator/src/lib.rs", text).is_empty());
    assert!(lines(packages, "tests/tests/x.rs", text).is_empty());
}

#[test]
fn import_groups_are_taken_apart() {
    assert_eq!(imported("scene::description::Wrap;"), ["scene::description"]);
    assert_eq!(imported("VERSION;"), ["VERSION"]);
    assert_eq!(
        imported("{math::{Rgb, ops}, scene::plan::Plan, error};"),
        ["math::Rgb", "scene::plan", "error"].map(String::from).map(|s| if s == "math::Rgb" {
            "math".to_owned()
        } else {
            s
        })
    );
}

#[test]
fn render_modules_may_import_downwards_only() {
    let text = "use crate::scene::description::Wrap;\nuse crate::{error::SceneError, scene::plan::Plan};\n\
                #[cfg(test)]\nmod tests {\n    use crate::job::PreparedJob;\n}\nuse crate::math::Rgb;\n";
    assert_eq!(lines(render_modules, "render/src/material/x.rs", text), [2]);
    assert_eq!(lines(render_modules, "render/src/math/x.rs", text), [1, 2, 2]);
    assert!(lines(render_modules, "render/src/job.rs", text).is_empty());
    assert_eq!(lines(render_modules, "render/src/novelty.rs", text), [1]);
}

#[test]
fn pure_parts_know_no_clock_and_no_network() {
    let text = "use std::time::Instant;\nfn f() { tokio::spawn(g); }\n#[test]\nfn t() { println!(\"x\"); }\n";
    assert_eq!(lines(pure_parts, "render/src/photon/x.rs", text), [1, 2]);
    assert_eq!(lines(pure_parts, "coordinator/src/schedule/lease.rs", text).len(), 2);
    assert!(lines(pure_parts, "coordinator/src/driver.rs", text).is_empty());
}

#[test]
fn libraries_are_named_at_home() {
    let text = "use obvhs::Boundable;\nfn f() { bincode::decode(); }\n";
    assert_eq!(lines(homes, "render/src/scene/builder.rs", text), [1, 2]);
    assert_eq!(lines(homes, "render/src/geometry/bvh.rs", text), [2]);
    assert_eq!(lines(homes, "proto/src/payload/map.rs", text), [1]);
}

#[test]
fn platform_mathematics_is_found_as_method_and_as_path() {
    let text = "let a = x.sin();\nlet b = self.cos(wo);\nlet c = v.map(f32::exp);\nlet d = x.powi(2);\nlet e = ops::ln(x);\n\
                let f = Quat::from_rotation_x(a);\nlet g = x.sqrt();\n#[cfg(test)]\nmod tests { fn f() { x.sin(); } }\n";
    let mut found = lines(platform_mathematics, "render/src/light/x.rs", text);
    found.sort_unstable();
    assert_eq!(found, [1, 3, 4, 6]);
    assert!(lines(platform_mathematics, "render/src/math/ops.rs", text).is_empty());
    assert!(lines(platform_mathematics, "coordinator/src/x.rs", text).is_empty());
}
