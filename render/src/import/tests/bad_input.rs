//! Members of the wrong kind, missing members, strange names.

use super::builder::Builder;
use crate::import::limits::MAX_WARNINGS;
use serde_json::{Value, json};

#[test]
fn members_of_a_wrong_kind_are_named() {
    let b = Builder::square();
    let error = |pointer: &str, value: Value| b.but(pointer, value).error();
    assert_eq!(error("/meshes", json!({})), "test.glb: meshes: expected an array, found an object");
    assert_eq!(error("/meshes/0", json!(3)), "test.glb: meshes[0] must be an object");
    assert_eq!(
        error("/meshes/0/primitives", Value::Null),
        "test.glb: meshes[0].primitives: expected an array, found null"
    );
    assert_eq!(
        error("/meshes/0/primitives/0", json!([])),
        "test.glb: meshes[0].primitives[0]: expected an object, found an array of 0"
    );
    assert_eq!(error("/nodes/0/mesh", json!(true)), "test.glb: nodes[0].mesh: expected a whole number ≥ 0, found true");
    assert_eq!(error("/scene", json!(1)), "test.glb: scene: refers to scenes[1], but scenes has only 1 entries");
    assert_eq!(error("/extensionsUsed", json!("KHR")), "test.glb: extensionsUsed: expected an array, found \"KHR\"");
    assert_eq!(b.without("/meshes/0/primitives").error(), "test.glb: meshes[0]: \"primitives\" is missing");
    assert_eq!(
        b.without("/meshes/0/primitives/0/attributes").error(),
        "test.glb: meshes[0].primitives[0]: \"attributes\" is missing"
    );
    assert_eq!(b.without("/accessors/0/componentType").error(), "test.glb: accessors[0]: \"componentType\" is missing");
}

#[test]
fn names_cannot_write_to_the_terminal_or_flood_it() {
    let wild = format!("\u{1b}[2J\n{}", "x".repeat(10_000));
    let mut b = Builder::square().but("/meshes/0/name", json!(wild));
    b.set("/meshes/0/primitives/0/mode", json!(0));
    let warning = b.warning();
    assert!(warning.starts_with("mesh \"\\u{1b}[2J\\nxxx") && warning.len() < 200, "{warning}");
}

#[test]
fn warnings_are_bounded_and_said_once() {
    let mut b = Builder::square();
    for mesh in 0..200 {
        b.push("meshes", json!({ "name": format!("m{mesh}"), "primitives": [{ "attributes": {}, "mode": 0 }, { "attributes": {}, "mode": 1 }] }));
        b.node(json!({ "mesh": mesh + 1 }));
    }
    let warnings = b.scene().warnings;
    assert_eq!(warnings.len(), MAX_WARNINGS + 1);
    assert_eq!(warnings[MAX_WARNINGS], "further warnings are not shown");
}

#[test]
fn what_stands_still_is_said() {
    let mut b = Builder::square();
    b.set("/nodes/0/skin", json!(0));
    b.push("animations", json!({}));
    b.set("/meshes/0/primitives/0/targets", json!([{}]));
    assert_eq!(
        b.scene().warnings,
        [
            "node \"Square\": its skin is left out; the mesh is shown in its rest pose",
            "animations are left out; nodes stand where their own transforms put them",
            "mesh \"Sheet\": morph targets are left out; the base shape is shown"
        ]
    );
}
