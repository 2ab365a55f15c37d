//! Rooms that between them hold every kind of light transport, each easy enough that path tracing converges.

use crate::fixtures::{SceneMaker, cuboid, look_along, quad, sphere};
use gatherlight_render::math::Rgb;
use gatherlight_render::scene::description::{
    CameraDescription, ImageDescription, LightKind, MaterialDescription, Projection, SceneDescription,
    TextureDescription, TextureRef, Wrap,
};
use glam::{DVec3, Vec2, Vec3, Vec4};

/// Inner size of the rooms: from −1 to 1 along each axis.
const WALL: f32 = 1.0;

fn room(s: &mut SceneMaker) {
    let wall = s.material(MaterialDescription::lambert("wall", Rgb::new(0.6, 0.5, 0.4)));
    s.mesh(cuboid(Vec3::splat(-WALL), Vec3::splat(WALL), true, wall));
}

fn ceiling_lamp(s: &mut SceneMaker, radiance: f32, half: f32) {
    let lamp = s.material(MaterialDescription::emitter("lamp", Rgb::splat(radiance)));
    s.mesh(quad(Vec3::new(-half, 0.98, -half), Vec3::X * (2.0 * half), Vec3::Z * (2.0 * half), lamp));
}

fn eye(s: &mut SceneMaker) {
    s.camera(DVec3::new(0.0, 0.0, 0.95), DVec3::new(0.0, -0.3, 0.0), 1.3);
}

/// Lambertian walls and a block, under a lamp.
pub fn diffuse_room() -> SceneDescription {
    let mut s = SceneMaker::new();
    room(&mut s);
    ceiling_lamp(&mut s, 5.0, 0.5);
    let red = s.material(MaterialDescription::lambert("red", Rgb::new(0.7, 0.2, 0.1)));
    s.mesh(cuboid(Vec3::new(-0.5, -0.98, -0.5), Vec3::new(0.1, -0.3, 0.0), false, red));
    eye(&mut s);
    s.scene
}

/// Rough gold, a coated floor and a half-metal block: every lobe but Dirac ones.
pub fn glossy_room() -> SceneDescription {
    let mut s = SceneMaker::new();
    room(&mut s);
    let coated = s.material(MaterialDescription {
        base_color: Rgb::new(0.3, 0.5, 0.6),
        metallic: 0.0,
        roughness: 0.4,
        ..Default::default()
    });
    let gold = s.material(MaterialDescription::metal("gold", Rgb::new(1.0, 0.77, 0.34), 0.5));
    let half = s.material(MaterialDescription { metallic: 0.5, roughness: 0.6, ..Default::default() });
    s.mesh(quad(Vec3::new(-0.99, -0.98, 0.99), Vec3::X * 1.98, Vec3::Z * -1.98, coated));
    ceiling_lamp(&mut s, 5.0, 0.5);
    s.mesh(sphere(Vec3::new(-0.4, -0.6, -0.2), 0.35, 3, true, false, gold));
    s.mesh(cuboid(Vec3::new(0.2, -0.98, -0.5), Vec3::new(0.6, -0.3, 0.0), false, half));
    eye(&mut s);
    s.scene
}

/// A mirror, a smoothly coated block and a body of smooth glass that absorbs, under a large lamp.
pub fn specular_room() -> SceneDescription {
    let mut s = SceneMaker::new();
    room(&mut s);
    ceiling_lamp(&mut s, 3.0, 0.8);
    let mirror = s.material(MaterialDescription::metal("mirror", Rgb::splat(0.9), 0.0));
    let coat = s.material(MaterialDescription {
        base_color: Rgb::new(0.2, 0.6, 0.3),
        metallic: 0.0,
        roughness: 0.0,
        ..Default::default()
    });
    let glass = s.material(MaterialDescription {
        attenuation_color: Rgb::new(0.4, 0.8, 0.6),
        attenuation_distance: 0.5,
        ..MaterialDescription::glass("tinted", 1.5)
    });
    s.mesh(quad(Vec3::new(-0.9, -0.9, -0.9), Vec3::X * 1.8, Vec3::Y * 1.2, mirror));
    s.mesh(cuboid(Vec3::new(-0.7, -0.98, -0.3), Vec3::new(-0.2, -0.5, 0.2), false, coat));
    s.mesh(cuboid(Vec3::new(0.1, -0.98, -0.4), Vec3::new(0.6, -0.4, 0.1), false, glass));
    eye(&mut s);
    s.scene
}

/// A slab and a ball of rough glass that absorb, the slab between the lamp and the floor.
pub fn rough_glass_room() -> SceneDescription {
    let mut s = SceneMaker::new();
    room(&mut s);
    ceiling_lamp(&mut s, 5.0, 0.6);
    let glass = |roughness| MaterialDescription {
        roughness,
        attenuation_color: Rgb::new(0.4, 0.6, 0.9),
        attenuation_distance: 0.4,
        ..MaterialDescription::glass("frosted", 1.4)
    };
    let (slab, ball) = (s.material(glass(0.6)), s.material(glass(0.5)));
    s.mesh(cuboid(Vec3::new(-0.9, 0.2, -0.9), Vec3::new(0.1, 0.35, 0.9), false, slab));
    s.mesh(sphere(Vec3::new(0.4, -0.5, 0.0), 0.35, 3, true, false, ball));
    eye(&mut s);
    s.scene
}

/// Shading normals far from geometric ones: a coarse sphere with smooth normals and a floor with a normal map, both of
/// them coated, and textured.
pub fn bumpy_room() -> SceneDescription {
    let mut s = SceneMaker::new();
    room(&mut s);
    ceiling_lamp(&mut s, 5.0, 0.5);
    s.scene.images.extend([bumps(), checks()]);
    for image in 0..2 {
        s.scene.textures.push(TextureDescription { image, wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, nearest: false });
    }
    let texture = |texture| Some(TextureRef { texture, uv_set: 0 });
    let floor = s.material(MaterialDescription {
        normal_texture: texture(0),
        base_color_texture: texture(1),
        metallic: 0.0,
        roughness: 0.5,
        ..Default::default()
    });
    let coarse = s.material(MaterialDescription {
        base_color: Rgb::new(0.8, 0.7, 0.3),
        metallic: 0.0,
        roughness: 0.6,
        ..Default::default()
    });
    let mut mesh = quad(Vec3::new(-0.99, -0.97, 0.99), Vec3::X * 1.98, Vec3::Z * -1.98, floor);
    mesh.uvs[0] = Some([(0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (0.0, 3.0)].map(|(u, v)| Vec2::new(u, v)).to_vec());
    mesh.tangents = Some(vec![Vec4::new(1.0, 0.0, 0.0, 1.0); 4]);
    mesh.normals = Some(vec![Vec3::Y; 4]);
    s.mesh(mesh);
    s.mesh(sphere(Vec3::new(-0.3, -0.5, -0.3), 0.4, 1, true, false, coarse));
    eye(&mut s);
    s.scene
}

/// A point light, a spot and the sun shine into a room without ceiling that holds a coated block and a mirror.
pub fn sunny_room() -> SceneDescription {
    let mut s = SceneMaker::new();
    let wall = s.material(MaterialDescription::lambert("wall", Rgb::new(0.6, 0.5, 0.4)));
    let mut walls = cuboid(Vec3::splat(-WALL), Vec3::splat(WALL), true, wall);
    let up = |t: &[u32; 3]| t.iter().all(|&v| v & 2 != 0);
    walls.triangles.retain(|t| !up(t));
    s.mesh(walls);
    let coated = s.material(MaterialDescription {
        base_color: Rgb::new(0.3, 0.5, 0.6),
        metallic: 0.0,
        roughness: 0.5,
        ..Default::default()
    });
    s.mesh(cuboid(Vec3::new(-0.5, -0.98, -0.5), Vec3::new(0.1, -0.3, 0.0), false, coated));
    s.light(LightKind::Point, Rgb::new(0.8, 0.7, 0.6), DVec3::new(0.5, 0.4, 0.2), DVec3::NEG_Y);
    let spot = LightKind::Spot { inner: 0.2, outer: 0.6 };
    s.light(spot, Rgb::new(1.0, 2.0, 1.0), DVec3::new(-0.7, 0.6, 0.6), DVec3::new(0.6, -1.0, -0.8));
    s.light(LightKind::Directional, Rgb::splat(1.5), DVec3::Y * 3.0, DVec3::new(0.3, -1.0, -0.2));
    eye(&mut s);
    s.scene
}

/// The glossy room through parallel rays.
pub fn orthographic_room() -> SceneDescription {
    let mut s = glossy_room();
    s.cameras = vec![CameraDescription {
        name: "camera".into(),
        to_world: look_along(DVec3::new(0.0, 0.0, 0.9), DVec3::new(0.0, -0.2, -1.0)),
        projection: Projection::Orthographic { xmag: 0.7, ymag: 0.7 },
    }];
    s
}

/// Every room with its name.
pub fn rooms() -> Vec<(&'static str, SceneDescription)> {
    vec![
        ("diffuse", diffuse_room()),
        ("glossy", glossy_room()),
        ("specular", specular_room()),
        ("rough glass", rough_glass_room()),
        ("bumpy", bumpy_room()),
        ("sunny", sunny_room()),
        ("orthographic", orthographic_room()),
    ]
}

/// A normal map of tilted tiles, 8 × 8.
fn bumps() -> ImageDescription {
    let rgba = (0..64u32)
        .flat_map(|i| {
            let (x, y) = (i % 8, i / 8);
            let tilt = |v: u32| if v % 4 < 2 { 80u8 } else { 176 };
            [tilt(x), tilt(y + 1), 220, 255]
        })
        .collect();
    ImageDescription { name: "bumps".into(), width: 8, height: 8, rgba }
}

/// Light and dark checks, 4 × 4.
fn checks() -> ImageDescription {
    let rgba = (0..16u32)
        .flat_map(|i| if (i % 4 + i / 4) % 2 == 0 { [230, 200, 180, 255] } else { [90, 120, 150, 255] })
        .collect();
    ImageDescription { name: "checks".into(), width: 4, height: 4, rgba }
}
