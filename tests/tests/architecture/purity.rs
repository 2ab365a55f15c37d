//! What stays out of the pure parts, and libraries that one place only may name.

use crate::Violation;
use crate::source::{Source, is_word_char};

/// Library, where it may be named (path prefixes), and what to do instead.
const HOMES: [(&str, &[&str], &str); 4] = [
    ("obvhs", &["render/src/geometry/bvh.rs"], "rays meet geometry through geometry::Accelerator"),
    ("bincode", &["proto/src/payload"], "payloads are encoded and decoded in proto/src/payload, with a limit"),
    ("prost", &["proto/"], "messages are turned into domain types in proto/src/convert"),
    ("libm", &["render/src/math/ops.rs"], "call math::ops"),
];

/// What neither `render` nor the scheduler may name, and why.
const IMPURE: [(&str, &str); 13] = [
    ("Instant", "no clock: time is an argument, as a Duration"),
    ("SystemTime", "no clock: time is an argument"),
    ("std::fs", "no files: bytes in, bytes out"),
    ("std::net", "no network"),
    ("std::env", "no environment: settings are arguments"),
    ("std::process", "no processes"),
    ("std::thread", "no threads of its own: rayon in render, none in the scheduler"),
    ("tokio", "no async: compute threads are not async threads"),
    ("tonic", "no network: conversions are in proto, calls in coordinator and worker"),
    ("tracing", "no logging: return what should be reported"),
    ("println!", "no output: return what should be reported"),
    ("eprintln!", "no output: return what should be reported"),
    ("dbg!", "no output: return what should be reported"),
];

/// Functions of the platform's mathematics library without further arguments, as methods of f32 and f64 (and of glam's
/// vectors): `x.sin()`.
const UNARY: [&str; 20] = [
    "sin", "cos", "tan", "sin_cos", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "exp",
    "exp2", "exp_m1", "ln", "ln_1p", "log2", "log10",
];
/// The same with arguments.
const WITH_ARGUMENTS: [&str; 5] = ["powf", "powi", "atan2", "hypot", "cbrt"];
/// Functions of glam that call them.
const OF_GLAM: [&str; 9] = [
    "from_rotation_x",
    "from_rotation_y",
    "from_rotation_z",
    "from_axis_angle",
    "from_euler",
    "from_scaled_axis",
    "angle_between",
    "slerp",
    "from_angle",
];

/// Some libraries are named in one place only.
pub(crate) fn homes(source: &Source) -> Vec<Violation> {
    let mut violations = Vec::new();
    for (library, places, instead) in HOMES {
        if places.iter().any(|place| source.path.starts_with(place)) {
            continue;
        }
        let uses = source.words_outside_tests(library);
        let uses = uses.filter(|offset| source.code[offset + library.len()..].starts_with("::"));
        violations.extend(uses.map(|offset| {
            Violation::at(source, offset, format!("{library} is named in {} only: {instead}", places.join(", ")))
        }));
    }
    violations
}

fn is_pure_part(path: &str) -> bool {
    path.starts_with("render/src/") || path.starts_with("coordinator/src/schedule")
}

/// `render` and the scheduler know no clock, files, network, async or logging.
pub(crate) fn pure_parts(source: &Source) -> Vec<Violation> {
    if !is_pure_part(&source.path) {
        return Vec::new();
    }
    let uses = IMPURE.iter().flat_map(|&(word, why)| source.words_outside_tests(word).map(move |o| (o, word, why)));
    uses.map(|(offset, word, why)| Violation::at(source, offset, format!("{word} in a pure part: {why}"))).collect()
}

/// `render` takes its transcendental functions from math::ops, whose bits are the same on every machine.
pub(crate) fn platform_mathematics(source: &Source) -> Vec<Violation> {
    if !source.path.starts_with("render/src/") || source.path == "render/src/math/ops.rs" {
        return Vec::new();
    }
    let message =
        |name: &str| format!("{name} of the platform differs between machines in the last bit: use math::ops::{name}");
    let mut violations = Vec::new();
    for name in UNARY.into_iter().chain(WITH_ARGUMENTS).chain(OF_GLAM) {
        for offset in source.words_outside_tests(name) {
            let (before, after) = (&source.code[..offset], &source.code[offset + name.len()..]);
            let method =
                before.ends_with('.') && (after.starts_with("()") || !UNARY.contains(&name) && after.starts_with('('));
            let path = before.strip_suffix("::").is_some_and(|b| names_float_or_glam(b, name));
            if method || path {
                violations.push(Violation::at(source, offset, message(name)));
            }
        }
    }
    violations
}

/// Whether the path before `::name` ends in `f32`, `f64` or, for glam's functions, in a type.
fn names_float_or_glam(before: &str, name: &str) -> bool {
    let last = before.rsplit(|c: char| !is_word_char(c)).next().unwrap_or_default();
    ["f32", "f64"].contains(&last) || (OF_GLAM.contains(&name) && last.starts_with(char::is_uppercase))
}
