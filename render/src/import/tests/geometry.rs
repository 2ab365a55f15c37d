//! Accessors, topologies, attributes.

use super::builder::{Builder, F32, SQUARE, U8, U16, U32, f32s, u16s, u32s};
use crate::geometry::Mesh;
use glam::{Vec2, Vec3};
use serde_json::{Value, json};

/// The triangles as corner positions, which do not depend on how vertices are numbered.
fn corners(mesh: &Mesh) -> Vec<[[f32; 3]; 3]> {
    mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize].to_array())).collect()
}
fn at(i: usize) -> [f32; 3] {
    [SQUARE[3 * i], SQUARE[3 * i + 1], SQUARE[3 * i + 2]]
}
fn expected(triangles: &[[usize; 3]]) -> Vec<[[f32; 3]; 3]> {
    triangles.iter().map(|t| t.map(at)).collect()
}

/// The square drawn by the given indices.
fn drawn(mode: u64, component: u64, indices: &[u8], count: usize) -> Builder {
    let mut b = Builder::square();
    let accessor = b.accessor(component, "SCALAR", count, indices);
    b.set("/meshes/0/primitives/0/indices", json!(accessor));
    b.set("/meshes/0/primitives/0/mode", json!(mode));
    b
}

#[test]
fn every_index_type_and_topology_gives_the_square() {
    let list = [0u8, 1, 2, 0, 2, 3];
    let wide = list.map(u16::from);
    let wider = list.map(u32::from);
    for (component, bytes) in [(U8, list.to_vec()), (U16, u16s(&wide)), (U32, u32s(&wider))] {
        assert_eq!(corners(&drawn(4, component, &bytes, 6).clean_scene().meshes[0]), expected(&[[0, 1, 2], [0, 2, 3]]));
    }
    // glTF §3.7.2.1: a strip turns every other triangle, a fan begins with its second corner.
    let strip = drawn(5, U8, &[1, 2, 0, 3], 4).clean_scene();
    assert_eq!(corners(&strip.meshes[0]), expected(&[[1, 2, 0], [2, 3, 0]]));
    let fan = drawn(6, U8, &[0, 1, 2, 3], 4).clean_scene();
    assert_eq!(corners(&fan.meshes[0]), expected(&[[1, 2, 0], [2, 3, 0]]));
    let mut bare = drawn(5, U8, &[0], 1).without("/meshes/0/primitives/0/indices");
    bare.set("/accessors/0/count", json!(3));
    assert_eq!(corners(&bare.clean_scene().meshes[0]), expected(&[[0, 1, 2]]));
}

#[test]
fn all_triangles_of_strips_and_fans_face_the_same_way() {
    for mode in [5, 6] {
        let order: &[u8] = if mode == 5 { &[1, 2, 0, 3] } else { &[0, 1, 2, 3] };
        for [a, b, c] in corners(&drawn(mode, U8, order, 4).clean_scene().meshes[0]) {
            let normal = (Vec3::from(b) - Vec3::from(a)).cross(Vec3::from(c) - Vec3::from(a));
            assert!(normal.z > 0.0, "mode {mode}: {normal}");
        }
    }
}

#[test]
fn points_and_lines_are_left_out_and_said() {
    for mode in 0..4 {
        let b = drawn(mode, U8, &[0, 1, 2, 3], 4);
        assert!(b.scene().meshes.is_empty());
        assert_eq!(b.warning(), "mesh \"Sheet\": points and lines are left out; only triangles are rendered");
    }
    assert!(drawn(7, U8, &[0], 1).error().contains("meshes[0].primitives[0].mode: 7 is not a primitive mode"));
    let odd = drawn(4, U8, &[0, 1, 2, 0, 2], 5);
    assert!(odd.warning().contains("5 indices make no whole number of triangles"));
    assert_eq!(odd.scene().meshes[0].triangles.len(), 1);
}

#[test]
fn triangles_without_area_are_left_out_and_counted() {
    let b = drawn(4, U8, &[0, 1, 2, 0, 0, 1, 1, 2, 1, 0, 2, 3], 12);
    assert_eq!(b.scene().meshes[0].triangles.len(), 2);
    assert_eq!(b.warning(), "mesh \"Sheet\": 2 of 4 triangles have no area and are left out");
    let mut line = Builder::square();
    line.attribute("POSITION", F32, "VEC3", 4, &f32s(&[0.1, 0.1, 0.1, 0.2, 0.2, 0.2, 0.4, 0.4, 0.4, 0.8, 0.8, 0.8]));
    assert!(line.warning().contains("2 of 2 triangles have no area"));
    assert!(line.scene().instances.is_empty());
}

#[test]
fn interleaved_and_sparse_accessors_read_alike() {
    let mut b = Builder::square();
    let mut rows = Vec::new();
    for i in 0..4 {
        rows.extend(f32s(&at(i)));
        rows.extend(f32s(&[9.0, 9.0]));
    }
    let view = b.view(&rows);
    b.set(&format!("/bufferViews/{view}/byteStride"), json!(20));
    b.json["accessors"][0] = json!({ "bufferView": view, "componentType": F32, "type": "VEC3", "count": 4 });
    assert_eq!(corners(&b.clean_scene().meshes[0]), expected(&[[0, 1, 2], [0, 2, 3]]));

    // Zeros, but for elements 1, 2 and 3.
    let indices = b.view(&u16s(&[1, 2, 3]));
    let values = b.view(&f32s(&SQUARE[3..]));
    b.json["accessors"][0] = json!({ "componentType": F32, "type": "VEC3", "count": 4, "sparse": {
        "count": 3,
        "indices": { "bufferView": indices, "componentType": U16 },
        "values": { "bufferView": values }
    } });
    assert_eq!(corners(&b.clean_scene().meshes[0]), expected(&[[0, 1, 2], [0, 2, 3]]));

    let sparse = |pointer: &str, value: Value| b.but(&format!("/accessors/0/sparse/{pointer}"), value).error();
    assert!(
        sparse("count", json!(5))
            .contains("accessors[0].sparse.count: must be from 1 to the accessor's count 4, found 5")
    );
    assert!(sparse("indices/componentType", json!(F32)).contains("sparse indices must be unsigned integers"));
    assert!(
        sparse("values/bufferView", json!(indices)).contains("accessors[0].sparse.values: out of range: 3 elements")
    );
    let mut unsorted = b.clone();
    let offset = b.json["bufferViews"][indices]["byteOffset"].as_u64().expect("an offset") as usize;
    unsorted.bin[offset] = 2;
    assert_eq!(
        unsorted.error(),
        "test.glb: accessors[0].sparse.indices: sparse indices must ascend and stay below the accessor's count 4"
    );
}

#[test]
fn normalized_integers_become_fractions() {
    let mut b = Builder::with_material(json!({ "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 0 } }));
    b.texture(&super::builder::png(1, 1, &[255; 4]), "image/png");
    b.attribute("TEXCOORD_0", U16, "VEC2", 4, &u16s(&[0, 0, 65_535, 0, 65_535, 32_768, 0, 65_535]));
    b.attribute("NORMAL", 5120, "VEC3", 4, &[0, 0, 127, 0, 0, 127, 0, 0, 0, 0, 127, 0, 0, 0, 128, 0]);
    let (uv, normal) =
        (b.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"].clone(), b.json["accessors"].clone());
    assert_eq!(normal.as_array().map(Vec::len), Some(4));
    b.set(&format!("/accessors/{uv}/normalized"), json!(true));
    b.set("/accessors/3/normalized", json!(true));
    let view = b.json["accessors"][3]["bufferView"].clone();
    b.set(&format!("/bufferViews/{view}/byteStride"), json!(4));
    b.attribute("COLOR_0", U8, "VEC4", 4, &[0, 51, 255, 128, 0, 0, 0, 255, 0, 0, 0, 255, 0, 0, 0, 255]);
    b.set("/accessors/4/normalized", json!(true));
    let mesh = &b.clean_scene().meshes[0];
    let uvs = mesh.uvs[0].as_ref().expect("coordinates");
    assert_eq!(uvs[2], Vec2::new(1.0, 32_768.0 / 65_535.0));
    let normals = mesh.normals.as_ref().expect("normals");
    assert_eq!((normals[0], normals[1], normals[3]), (Vec3::Z, Vec3::Y, Vec3::NEG_Z));
    assert_eq!(mesh.colors.as_ref().expect("colours")[0], [0.0, 0.2, 1.0, 128.0 / 255.0]);
}

#[test]
fn quantized_positions_and_rgb_colours_are_read() {
    let mut b = Builder::square();
    b.json["extensionsUsed"] = json!(["KHR_mesh_quantization"]);
    b.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let rows: Vec<u8> = (0..4).flat_map(|i| at(i).map(|v| v as u8).into_iter().chain([0])).collect();
    b.attribute("POSITION", U8, "VEC3", 4, &rows);
    let view = b.json["accessors"][2]["bufferView"].clone();
    b.set(&format!("/bufferViews/{view}/byteStride"), json!(4));
    b.attribute("COLOR_0", F32, "VEC3", 4, &f32s(&[2.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]));
    assert_eq!(b.warning(), "mesh \"Sheet\": vertex colours outside 0 to 1 are clamped");
    let scene = b.scene();
    assert_eq!(corners(&scene.meshes[0]), expected(&[[0, 1, 2], [0, 2, 3]]));
    assert_eq!(scene.meshes[0].colors.as_ref().expect("colours")[0], [1.0, 0.5, 0.0, 1.0]);
}

#[test]
fn missing_normals_stay_missing_and_broken_ones_are_made() {
    let mut b = Builder::square();
    assert!(b.clean_scene().meshes[0].normals.is_none(), "flat");
    b.attribute("NORMAL", F32, "VEC3", 4, &f32s(&[0.0, 0.0, 0.0, 0.0, 3e-30, 0.0, 2e30, 0.0, 0.0, 0.0, 0.0, -1.0]));
    let scene = b.scene();
    let normals = scene.meshes[0].normals.as_ref().expect("normals");
    assert_eq!(normals[..], [Vec3::Z, Vec3::Y, Vec3::X, Vec3::NEG_Z]);
    assert_eq!(b.warning(), "mesh \"Sheet\": 1 normals have length zero and are made from the faces around them");
}

#[test]
fn unused_vertices_are_left_out_however_large_the_array() {
    let mut b = Builder::square();
    let mut positions = vec![f32::NAN; 3 * 1000];
    positions[3 * 990..3 * 994].copy_from_slice(&SQUARE);
    b.attribute("POSITION", F32, "VEC3", 1000, &f32s(&positions));
    let indices = b.accessor(U16, "SCALAR", 6, &u16s(&[990, 991, 992, 990, 992, 993]));
    b.set("/meshes/0/primitives/0/indices", json!(indices));
    let mesh = &b.clean_scene().meshes[0];
    assert_eq!(mesh.positions.len(), 4);
    assert_eq!(corners(mesh), expected(&[[0, 1, 2], [0, 2, 3]]));
}

#[test]
fn tangents_follow_u_and_know_mirrored_textures() {
    let mut b = Builder::with_material(json!({ "normalTexture": { "index": 0, "scale": 0.5 } }));
    b.texture(&super::builder::png(1, 1, &[128, 128, 255, 255]), "image/png");
    b.attribute("NORMAL", F32, "VEC3", 4, &f32s(&[0.0, 0.0, 1.0].repeat(4)));
    // The image upright on the square: u along +x, v along −y.
    b.attribute("TEXCOORD_0", F32, "VEC2", 4, &f32s(&[0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]));
    let scene = b.clean_scene();
    assert_eq!(scene.materials[0].normal_scale, 0.5);
    for tangent in scene.meshes[0].tangents.as_ref().expect("tangents") {
        assert_eq!(tangent.to_array(), [1.0, 0.0, 0.0, 1.0], "the bitangent Z × X = Y is up in the image");
    }
    // Mirrored on one triangle only: u is −x there, and the shared edge must be split.
    b.attribute("TEXCOORD_0", F32, "VEC2", 4, &f32s(&[0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 2.0, 0.0]));
    let mesh = &b.clean_scene().meshes[0];
    let tangents = mesh.tangents.as_ref().expect("tangents");
    assert_eq!((mesh.positions.len(), tangents.len()), (6, 6));
    for (triangle, sign) in mesh.triangles.iter().zip([1.0, -1.0]) {
        for v in triangle {
            assert_eq!(tangents[*v as usize].w, sign, "{tangents:?}");
        }
    }
    // Without normals the faces are taken apart; given tangents are made unit and orthogonal.
    let flat = b.without("/meshes/0/primitives/0/attributes/NORMAL").clean_scene();
    assert_eq!((flat.meshes[0].positions.len(), flat.meshes[0].normals.is_none()), (6, true));
    assert_eq!(flat.meshes[0].tangents.as_ref().map(Vec::len), Some(6));
    b.attribute("TANGENT", F32, "VEC4", 4, &f32s(&[0.0, 3.0, 4.0, -1.0].repeat(4)));
    let given = b.clean_scene();
    assert_eq!(given.meshes[0].tangents.as_ref().expect("tangents")[0].to_array(), [0.0, 1.0, 0.0, -1.0]);
}

#[test]
fn attributes_that_do_not_fit_are_errors() {
    let mut b = Builder::square();
    b.attribute("NORMAL", F32, "VEC2", 4, &f32s(&[0.0; 8]));
    let place = "test.glb: meshes[0].primitives[0].attributes.NORMAL";
    assert_eq!(b.error(), format!("{place}: NORMAL must be VEC3, but accessors[2] has 2 numbers an element"));
    b.attribute("NORMAL", F32, "VEC3", 3, &f32s(&[1.0; 9]));
    assert_eq!(
        b.error(),
        format!("{place}: accessors[3] has 3 elements, but POSITION has 4; all attributes need as many")
    );
    b.set("/meshes/0/primitives/0/attributes/NORMAL", json!(9));
    assert_eq!(b.error(), format!("{place}: refers to accessors[9], but accessors has only 4 entries"));
    b.attribute("NORMAL", F32, "VEC3", 4, &f32s(&[1.0, 0.0, f32::NAN, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0]));
    let nan = b.error();
    assert!(nan.starts_with("test.glb: accessors[4]: element 0 is not finite: [1.0, 0.0, NaN]"), "{nan}");
}

#[test]
fn indices_out_of_range_or_of_a_wrong_type_are_errors() {
    let over = drawn(4, U8, &[0, 1, 4], 3).error();
    assert_eq!(over, "test.glb: accessors[2]: triangle 0 names vertex 4, but meshes[0].primitives[0] has 4 vertices");
    let float = drawn(4, F32, &f32s(&[0.0, 1.0, 2.0]), 3).error();
    assert!(float.contains(
        "primitives[0].indices: accessors[2] does not hold indices: it must be SCALAR of 5121, 5123 or 5125"
    ));
    let mut vector = drawn(4, U8, &[0, 1, 2, 0, 0, 0], 3);
    vector.set("/accessors/2/type", json!("VEC2"));
    assert!(vector.error().contains("accessors[2] does not hold indices"));
}

#[test]
fn a_file_that_unfolds_without_end_is_stopped() {
    // Four bytes of zeros would be four billion triangles.
    let mut b = Builder::square().without("/meshes/0/primitives/0/indices");
    b.json["accessors"][0] = json!({ "componentType": F32, "type": "VEC3", "count": 4_000_000_000u64 });
    let error = b.error();
    assert!(
        error.starts_with(
            "test.glb: meshes[0].primitives[0]: the number of triangles so far is 1333333333, over the limit of 419"
        ),
        "{error}"
    );
    // The same million indices by a hundred meshes.
    let mut b = Builder::square();
    let indices = b.accessor(U8, "SCALAR", 999_999, &[0, 1, 2].repeat(333_333));
    for mesh in 0..100 {
        b.push("meshes", json!({ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": indices }] }));
        b.node(json!({ "mesh": mesh + 1 }));
    }
    assert!(b.error().contains("the file names the same data over and over; place one mesh by several nodes instead"));
}
