//! Buffers, buffer views and accessors that do not fit.

use super::builder::{Builder, F32};
use serde_json::{Value, json};

fn error(pointer: &str, value: Value) -> String {
    Builder::square().but(pointer, value).error()
}

#[test]
fn views_must_lie_inside_their_buffers() {
    assert_eq!(error("/bufferViews/0/byteLength", json!(0)), "test.glb: bufferViews[0].byteLength: must be at least 1");
    assert_eq!(
        error("/bufferViews/1/byteLength", json!(100)),
        "test.glb: bufferViews[1]: bytes 48 to 48 + 100 lie outside buffers[0], which has 60 bytes"
    );
    let overflow = error("/bufferViews/0/byteOffset", json!(u64::MAX));
    assert!(overflow.contains("lie outside buffers[0]"), "{overflow}");
    assert!(
        error("/bufferViews/0/buffer", json!(1))
            .contains("bufferViews[0].buffer: refers to buffers[1], but buffers has only 1 entries")
    );
    // 2³² would be 0 if indices were taken modulo 2³².
    assert!(error("/bufferViews/0/buffer", json!(1u64 << 32)).contains("refers to buffers[4294967296]"));
    assert!(
        error("/bufferViews/0/byteStride", json!(6))
            .contains("byteStride: must be a multiple of 4 from 4 to 252, found 6")
    );
    assert!(
        error("/buffers/0/byteLength", json!(99))
            .contains("buffers[0].byteLength: says 99 bytes, but there are only 60")
    );
    assert!(
        error("/buffers/0/byteLength", json!(-1))
            .contains("buffers[0].byteLength: expected a whole number ≥ 0, found -1")
    );
}

#[test]
fn accessors_must_lie_inside_their_views() {
    assert_eq!(
        error("/accessors/0/count", json!(5)),
        "test.glb: accessors[0]: out of range: 5 elements from byteOffset 0 on do not fit the 48 bytes of bufferViews[0]"
    );
    assert!(
        error("/accessors/0/byteOffset", json!(4)).contains("accessors[0]: out of range: 4 elements from byteOffset 4")
    );
    assert!(
        error("/accessors/0/byteOffset", json!(2))
            .contains("accessors[0]: misaligned: byteOffset 2 in bufferViews[0] at byte 0")
    );
    assert!(error("/accessors/0/count", json!(u64::MAX)).contains("accessors[0].count: the number of elements is"));
    assert!(error("/accessors/0/count", json!(4_000_000_000u64)).contains("out of range"));
    assert!(error("/accessors/0/count", json!(0)).contains("accessors[0].count: must be at least 1"));
    assert!(
        error("/accessors/0/count", json!(3.5)).contains("accessors[0].count: expected a whole number ≥ 0, found 3.5")
    );
    let stride = error("/bufferViews/0/byteStride", json!(4));
    assert!(
        stride.contains("accessors[0]: its elements take 12 bytes, more than the byteStride 4 of bufferViews[0]"),
        "{stride}"
    );
    assert!(
        error("/accessors/0/componentType", json!(5124))
            .contains("accessors[0].componentType: 5124 is not a component type")
    );
    assert!(error("/accessors/0/type", json!("VEC5")).contains("accessors[0].type: must be SCALAR, VEC2"));
    assert!(
        error("/accessors/0/bufferView", json!("0"))
            .contains("accessors[0].bufferView: expected a whole number ≥ 0, found \"0\"")
    );
}

#[test]
fn every_accessor_is_checked_even_if_nothing_uses_it() {
    let mut b = Builder::square();
    b.push("accessors", json!({ "bufferView": 0, "componentType": F32, "type": "MAT4", "count": 1 }));
    assert!(b.error().contains("accessors[2]: out of range"), "{}", b.error());
    // MAT3 of bytes has padded columns: 12 bytes an element, so four fit 48 bytes and five do not.
    let matrix = |count: u64| {
        let mut b = Builder::square();
        b.push("accessors", json!({ "bufferView": 0, "componentType": 5121, "type": "MAT3", "count": count }));
        b
    };
    assert_eq!(matrix(4).clean_scene().meshes.len(), 1);
    assert!(matrix(5).error().contains("accessors[2]: out of range: 5 elements"));
}
