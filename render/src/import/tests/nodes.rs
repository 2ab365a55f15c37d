//! Hierarchies, instances, cameras and lights.

use super::builder::Builder;
use crate::scene::description::{LightKind, Projection};
use glam::{DAffine3, DQuat, DVec3};
use serde_json::{Value, json};

#[test]
fn transforms_multiply_down_the_tree_in_double_precision() {
    let mut b = Builder::square();
    // 2³⁰ + 2⁻²⁰ needs 51 bits: single precision would lose the second term.
    let far = 1_073_741_824.0 + 1.0 / 1_048_576.0;
    let half = std::f64::consts::FRAC_1_SQRT_2;
    b.json["nodes"] = json!([
        { "translation": [far, 0, 0], "children": [1] },
        { "rotation": [0, 0, half, half], "scale": [2, 3, -4], "children": [2] },
        { "name": "Leaf", "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1] }
    ]);
    let scene = b.clean_scene();
    let [leaf] = &scene.instances[..] else { panic!("one instance") };
    assert_eq!(leaf.name, "Leaf");
    let turn = DAffine3::from_scale_rotation_translation(
        DVec3::new(2.0, 3.0, -4.0),
        DQuat::from_xyzw(0.0, 0.0, half, half),
        DVec3::ZERO,
    );
    let expected = DAffine3::from_translation(DVec3::new(far, 0.0, 0.0))
        * turn
        * DAffine3::from_translation(DVec3::new(5.0, 6.0, 7.0));
    assert_eq!(leaf.to_world, expected);
    assert!(leaf.to_world.matrix3.determinant() < 0.0, "a negative scale mirrors");
    // A quarter turn takes (5·2, 6·3) to (−18, 10).
    let moved = leaf.to_world.translation - DVec3::new(far, 0.0, 0.0);
    assert!((moved - DVec3::new(-18.0, 10.0, -28.0)).abs().max_element() < 1e-6, "{moved}");
    let child = DAffine3::from_translation(DVec3::new(far, 0.0, 0.0));
    assert_eq!(child.translation.x - 1_073_741_824.0, 1.0 / 1_048_576.0);
}

#[test]
fn one_mesh_placed_by_many_nodes_is_read_once() {
    let mut b = Builder::square();
    for i in 0..10 {
        b.node(json!({ "mesh": 0, "translation": [i, 0, 0] }));
    }
    let scene = b.clean_scene();
    assert_eq!((scene.meshes.len(), scene.instances.len()), (1, 11));
    assert!(scene.instances.iter().all(|i| i.mesh == 0));
}

#[test]
fn only_the_selected_scene_is_read() {
    let mut b = Builder::square();
    let hidden = b.push("nodes", json!({ "mesh": 7 }));
    b.push("scenes", json!({ "nodes": [hidden] }));
    assert_eq!(b.clean_scene().instances.len(), 1);
    assert_eq!(b.without("/scene").clean_scene().instances.len(), 1);
    let other = b.but("/scene", json!(1)).error();
    assert_eq!(other, "test.glb: nodes[1].mesh: refers to meshes[7], but meshes has only 1 entries");
    let mut rootless = Builder::square().without("/scene").without("/scenes");
    rootless.json["nodes"] = json!([{ "name": "child", "mesh": 0 }, { "name": "root", "mesh": 0, "children": [0] }]);
    let names: Vec<String> = rootless.clean_scene().instances.into_iter().map(|i| i.name).collect();
    assert_eq!(names, ["root", "child"]);
}

#[test]
fn cycles_and_second_parents_are_errors() {
    let with = |nodes: Value, roots: Value| {
        let mut b = Builder::square();
        b.json["nodes"] = nodes;
        b.json["scenes"][0]["nodes"] = roots;
        b.error()
    };
    let cycle = with(json!([{ "children": [1] }, { "children": [2] }, { "children": [1] }]), json!([0]));
    assert!(cycle.starts_with("test.glb: nodes[2]: nodes[1] is already a child of nodes[0]"), "{cycle}");
    let own = with(json!([{ "children": [0] }]), json!([0]));
    assert_eq!(own, "test.glb: nodes[0]: the node is its own ancestor: children form a cycle");
    let pair = with(json!([{}, { "children": [2] }, { "children": [1] }]), json!([0]));
    assert_eq!(pair, "test.glb: nodes[1]: the node is its own ancestor: children form a cycle");
    let diamond = with(json!([{ "children": [1, 2] }, { "children": [3] }, { "children": [3] }, {}]), json!([0]));
    assert!(diamond.contains("nodes[2]: nodes[3] is already a child of nodes[1]"), "{diamond}");
    let no_root = with(json!([{ "children": [1] }, {}]), json!([1]));
    assert_eq!(no_root, "test.glb: scenes[0].nodes[0]: nodes[1] is no root: it is a child of nodes[0]");
    let twice = with(json!([{}]), json!([0, 0]));
    assert_eq!(twice, "test.glb: scenes[0].nodes[1]: nodes[0] is listed twice");
}

#[test]
fn a_chain_of_a_hundred_thousand_nodes_needs_no_deep_stack() {
    let mut b = Builder::square();
    let count = 100_000;
    let mut nodes: Vec<Value> = (1..count).map(|i| json!({ "children": [i], "translation": [1, 0, 0] })).collect();
    nodes.push(json!({ "mesh": 0 }));
    b.json["nodes"] = Value::Array(nodes);
    assert_eq!(b.clean_scene().instances[0].to_world.translation.x, f64::from(count - 1));
}

#[test]
fn damaged_transforms_are_errors() {
    let node = |value: Value| Builder::square().but("/nodes/0", value).error();
    assert!(
        node(json!({ "matrix": [1, 0, 0] }))
            .contains("nodes[0].matrix: expected an array of 16 numbers, found an array of 3")
    );
    let both = node(json!({ "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1], "scale": [1, 1, 1] }));
    assert!(both.contains("nodes[0]: has a matrix and also translation, rotation or scale"), "{both}");
    let projective = node(json!({ "matrix": [1,0,0,0.5, 0,1,0,0, 0,0,1,0, 0,0,0,1] }));
    assert!(projective.contains("nodes[0].matrix: its last row must be 0 0 0 1"), "{projective}");
    assert!(node(json!({ "rotation": [0, 0, 0, 0] })).contains("its rotation is a quaternion of length zero"));
    assert!(
        node(json!({ "translation": ["a", 0, 0] })).contains("nodes[0].translation[0]: expected a number, found \"a\"")
    );
    let mut huge = Builder::square();
    huge.json["nodes"] = json!([{ "scale": [1e200, 1, 1], "children": [1] }, { "scale": [1e200, 1, 1], "mesh": 0 }]);
    assert!(huge.error().contains("nodes[1]: the transforms from the root down to here multiply to infinity"));
}

#[test]
fn scales_of_zero_hide_or_squash() {
    let mut hidden = Builder::square();
    hidden.json["nodes"] = json!([{ "name": "Off", "scale": [0, 0, 0], "children": [1] }, { "mesh": 0 }]);
    assert!(hidden.scene().instances.is_empty());
    assert_eq!(hidden.warning(), "node \"Off\" is scaled to nothing and left out with all below it");
    let squashed =
        Builder::square().but("/nodes/0/scale", json!([2, 3, 0])).but("/nodes/0/translation", json!([7, 0, 0]));
    assert!(squashed.warning().contains("node \"Square\" is squashed flat"));
    let scene = squashed.scene();
    let instance = &scene.instances[0];
    assert_eq!(instance.to_world, DAffine3::from_translation(DVec3::new(7.0, 0.0, 0.0)));
    assert_eq!(scene.meshes[instance.mesh].positions[2].to_array(), [2.0, 3.0, 0.0]);
    let edge_on = Builder::square().but("/nodes/0/scale", json!([0, 1, 1]));
    assert!(edge_on.scene().instances.is_empty(), "a square squashed to a line is gone");
}

#[test]
fn cameras_are_named_after_their_nodes() {
    let mut b = Builder::square();
    b.json["cameras"] = json!([
        { "type": "perspective", "perspective": { "yfov": 0.5, "aspectRatio": 1.5, "znear": 0.1 } },
        { "name": "Plan", "type": "orthographic", "orthographic": { "xmag": 2, "ymag": 3, "znear": 0, "zfar": 9 } }
    ]);
    b.node(json!({ "name": "Front", "camera": 0, "translation": [0, 0, 5] }));
    b.node(json!({ "camera": 1 }));
    b.node(json!({ "camera": 0 }));
    let cameras = b.clean_scene().cameras;
    let names: Vec<&str> = cameras.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["Front", "Plan", "cameras[0]"]);
    assert_eq!(cameras[0].projection, Projection::Perspective { yfov: 0.5, aspect: Some(1.5) });
    assert_eq!(cameras[0].to_world.translation.z, 5.0);
    assert_eq!(cameras[1].projection, Projection::Orthographic { xmag: 2.0, ymag: 3.0 });

    let with = |lens: Value| b.but("/cameras/0", lens).error();
    let wide = with(json!({ "type": "perspective", "perspective": { "yfov": 3.2, "znear": 0.1 } }));
    assert_eq!(wide, "test.glb: cameras[0].perspective.yfov: must lie between 0 and π radians, found 3.2");
    assert!(
        with(json!({ "type": "fisheye" })).contains("cameras[0].type: must be \"perspective\" or \"orthographic\"")
    );
    assert!(with(json!({ "type": "perspective" })).contains("cameras[0]: \"perspective\" is missing"));
    let zero = json!({ "type": "orthographic", "orthographic": { "xmag": 0, "ymag": 1 } });
    assert!(with(zero).contains("cameras[0].orthographic.xmag: must not be zero"));
    let mirrored = json!({ "name": "M", "type": "orthographic", "orthographic": { "xmag": -2, "ymag": 1 } });
    assert!(b.but("/cameras/1", mirrored).warning().contains("camera \"M\": negative xmag or ymag"));
    assert!(b.but("/nodes/1/scale", json!([1, 0, 1])).error().contains("nodes[1]: carries a camera"));
}

#[test]
fn punctual_lights_keep_their_units() {
    let mut b = Builder::square();
    b.json["extensionsUsed"] = json!(["KHR_lights_punctual"]);
    b.json["extensionsRequired"] = json!(["KHR_lights_punctual"]);
    b.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": [
        { "type": "point", "color": [1, 0.5, 0.25], "intensity": 40 },
        { "name": "Cone", "type": "spot", "intensity": 2, "spot": { "innerConeAngle": 0.1, "outerConeAngle": 0.2 } },
        { "type": "directional" },
        { "type": "spot", "spot": { "outerConeAngle": 1.570_796_370_506_286_6 } }
    ] } });
    for light in 0..4 {
        b.node(json!({ "extensions": { "KHR_lights_punctual": { "light": light } } }));
    }
    b.set("/nodes/1/name", json!("Lamp"));
    let lights = b.clean_scene().lights;
    assert_eq!(lights.iter().map(|l| l.name.as_str()).collect::<Vec<_>>(), ["Lamp", "Cone", "lights[2]", "lights[3]"]);
    assert_eq!(lights[0].intensity.to_array(), [40.0, 20.0, 10.0]);
    assert_eq!(lights[1].kind, LightKind::Spot { inner: 0.1, outer: 0.2 });
    assert_eq!((lights[2].kind, lights[2].intensity.to_array()), (LightKind::Directional, [1.0; 3]));
    assert_eq!(lights[3].kind, LightKind::Spot { inner: 0.0, outer: std::f64::consts::FRAC_PI_2 });

    let light =
        |pointer: &str, value: Value| b.but(&format!("/extensions/KHR_lights_punctual/lights/{pointer}"), value);
    let place = "test.glb: extensions.KHR_lights_punctual.lights[";
    assert!(
        light("0/intensity", json!(-1))
            .error()
            .starts_with(&format!("{place}0]: color [1.0, 0.5, 0.25] × intensity -1"))
    );
    assert_eq!(
        light("0/type", json!("area")).error(),
        format!("{place}0].type: must be \"point\", \"spot\" or \"directional\"")
    );
    assert!(light("1/spot/innerConeAngle", json!(0.2)).error().contains("0 ≤ inner < outer ≤ π/2, found 0.2 and 0.2"));
    assert!(light("0/range", json!(5)).warning().contains("light \"Lamp\": its range is ignored"));
    let missing = b.but("/nodes/1/extensions/KHR_lights_punctual/light", json!(4)).error();
    assert_eq!(missing, "test.glb: nodes[1].extensions.KHR_lights_punctual.light: refers to light 4, but there are 4");
    assert!(b.without("/extensions").error().contains("the file lists no lights under extensions.KHR_lights_punctual"));
}
