//! A scene as an importer, or a test, describes it: plain data in the file's own units, not yet normalised.

use crate::geometry::Mesh;
use crate::math::Rgb;
use glam::DAffine3;

/// Everything an image can depend on.
#[derive(Clone, Debug, Default)]
pub struct SceneDescription {
    /// Meshes in object space.
    pub meshes: Vec<Mesh>,
    /// Placements of meshes.
    pub instances: Vec<InstanceDescription>,
    /// Materials; index 0.. as meshes name them.
    pub materials: Vec<MaterialDescription>,
    /// Textures: an image with a sampler.
    pub textures: Vec<TextureDescription>,
    /// Decoded images.
    pub images: Vec<ImageDescription>,
    /// Punctual lights.
    pub lights: Vec<LightDescription>,
    /// Cameras in file order.
    pub cameras: Vec<CameraDescription>,
    /// What was read but will not be shown as the file asks: each names the thing and what is lost.
    pub warnings: Vec<String>,
    /// What of the file was read and what was left out; empty for a scene made in code.
    pub parts: Vec<PlanEntry>,
}

/// One thing the image needs or does not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PlanEntry {
    /// The pass, map, field, transfer or part of the scene.
    pub what: String,
    /// Whether it is there.
    pub kept: bool,
    /// Why.
    pub reason: String,
    /// What leaving it out saves.
    pub saves: Saving,
    /// What the reason rests on: names and counts, one line each.
    pub evidence: Vec<String>,
}

/// What leaving something out saves, as far as it is known.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Saving {
    /// Bytes that are not sent to each process of a cluster.
    pub wire_bytes: u64,
    /// Bytes of memory.
    pub memory_bytes: u64,
    /// Computation, counted.
    pub work: String,
}

/// One placement of a mesh.
#[derive(Clone, Debug)]
pub struct InstanceDescription {
    /// Index of the mesh.
    pub mesh: usize,
    /// Object to world, in double precision.
    pub to_world: DAffine3,
    /// The node's name.
    pub name: String,
}

/// Stands for KHR_materials_ior's special value 0, with which the Fresnel reflectance is 1 at every angle, and bounds
/// all indices of refraction: ((n − 1)/(n + 1))² is 1 − 4e-6.
pub const IOR_FULL_REFLECTION: f32 = 1.0e6;

/// glTF metallic-roughness with the extensions the renderer supports. Factors are linear and already clamped.
#[derive(Clone, Debug)]
pub struct MaterialDescription {
    /// Name, for messages.
    pub name: String,
    /// Base colour, each channel in [0, 1].
    pub base_color: Rgb,
    /// Alpha factor.
    pub base_alpha: f32,
    /// sRGB texture multiplied into base colour and alpha.
    pub base_color_texture: Option<TextureRef>,
    /// Metallic factor in [0, 1].
    pub metallic: f32,
    /// Perceptual roughness in [0, 1]; α = roughness².
    pub roughness: f32,
    /// Green: roughness, blue: metallic.
    pub metallic_roughness_texture: Option<TextureRef>,
    /// Tangent-space normal map.
    pub normal_texture: Option<TextureRef>,
    /// Scale of the normal map's x and y.
    pub normal_scale: f32,
    /// Emitted radiance: emissiveFactor × emissive strength.
    pub emission: Rgb,
    /// sRGB texture multiplied into the emission.
    pub emissive_texture: Option<TextureRef>,
    /// Both faces are front.
    pub double_sided: bool,
    /// `Some(cutoff)`: points with alpha below it are holes.
    pub alpha_cutoff: Option<f32>,
    /// Transmission factor in [0, 1] (KHR_materials_transmission).
    pub transmission: f32,
    /// Red: transmission.
    pub transmission_texture: Option<TextureRef>,
    /// Index of refraction (KHR_materials_ior), from 1 to [`IOR_FULL_REFLECTION`].
    pub ior: f32,
    /// The surface bounds a solid refracting body (KHR_materials_volume thickness > 0).
    pub volume: bool,
    /// Beer–Lambert attenuation: colour white light reaches after `attenuation_distance`.
    pub attenuation_color: Rgb,
    /// Metres in the file's units; infinite for no attenuation.
    pub attenuation_distance: f32,
    /// KHR_materials_specular factor in [0, 1].
    pub specular: f32,
    /// KHR_materials_specular colour, ≥ 0.
    pub specular_color: Rgb,
    /// Alpha: specular factor.
    pub specular_texture: Option<TextureRef>,
    /// sRGB specular colour.
    pub specular_color_texture: Option<TextureRef>,
}

impl Default for MaterialDescription {
    /// glTF's default material.
    fn default() -> Self {
        MaterialDescription {
            name: String::new(),
            base_color: Rgb::WHITE,
            base_alpha: 1.0,
            base_color_texture: None,
            metallic: 1.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
            emission: Rgb::BLACK,
            emissive_texture: None,
            double_sided: false,
            alpha_cutoff: None,
            transmission: 0.0,
            transmission_texture: None,
            ior: 1.5,
            volume: false,
            attenuation_color: Rgb::WHITE,
            attenuation_distance: f32::INFINITY,
            specular: 1.0,
            specular_color: Rgb::WHITE,
            specular_texture: None,
            specular_color_texture: None,
        }
    }
}

impl MaterialDescription {
    /// A Lambertian surface, reflecting on both sides (metallic 0, specular 0).
    pub fn lambert(name: &str, base_color: Rgb) -> Self {
        MaterialDescription { name: name.into(), base_color, metallic: 0.0, specular: 0.0, ..Default::default() }
    }
    /// A metal with Schlick reflectance `f0`.
    pub fn metal(name: &str, f0: Rgb, roughness: f32) -> Self {
        MaterialDescription { name: name.into(), base_color: f0, roughness, ..Default::default() }
    }
    /// A solid smooth refracting body.
    pub fn glass(name: &str, ior: f32) -> Self {
        MaterialDescription {
            name: name.into(),
            metallic: 0.0,
            roughness: 0.0,
            transmission: 1.0,
            ior,
            volume: true,
            ..Default::default()
        }
    }
    /// A black surface that emits `radiance` from its front.
    pub fn emitter(name: &str, radiance: Rgb) -> Self {
        MaterialDescription { emission: radiance, ..Self::lambert(name, Rgb::BLACK) }
    }
}

/// A texture as a material uses it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureRef {
    /// Index into [`SceneDescription::textures`].
    pub texture: usize,
    /// Which of [`Mesh::uvs`]. Not always TEXCOORD_n of the file: the importer bakes KHR_texture_transform in.
    pub uv_set: usize,
}

/// An image with its sampler.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureDescription {
    /// Index into [`SceneDescription::images`].
    pub image: usize,
    /// Wrapping along u.
    pub wrap_u: Wrap,
    /// Wrapping along v.
    pub wrap_v: Wrap,
    /// Magnification filter is NEAREST.
    pub nearest: bool,
}

/// glTF wrap modes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Wrap {
    /// Repeat.
    #[default]
    Repeat,
    /// Repeat, mirrored every other time.
    MirroredRepeat,
    /// Clamp to the edge.
    ClampToEdge,
}

/// A decoded image, row 0 at the top.
#[derive(Clone, Debug)]
pub struct ImageDescription {
    /// Name, for messages.
    pub name: String,
    /// Width in pixels, ≥ 1.
    pub width: u32,
    /// Height in pixels, ≥ 1.
    pub height: u32,
    /// RGBA, 8 bits a channel as stored (sRGB or linear as the use says), `4 × width × height` bytes.
    pub rgba: Vec<u8>,
}

/// A punctual light (KHR_lights_punctual), shining along −z of `to_world`.
#[derive(Clone, Debug)]
pub struct LightDescription {
    /// Name, for messages.
    pub name: String,
    /// Placement; scale is ignored.
    pub to_world: DAffine3,
    /// Colour × intensity: candela for point and spot, lux for directional; carried 1:1 into radiometry.
    pub intensity: Rgb,
    /// Which kind.
    pub kind: LightKind,
}

/// Kinds of punctual light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// Isotropic.
    Point,
    /// Cone with glTF's recommended angular falloff; half-angles in radians, 0 ≤ inner < outer ≤ π/2.
    Spot {
        /// Full intensity inside.
        inner: f64,
        /// Nothing outside.
        outer: f64,
    },
    /// Parallel light along −z.
    Directional,
}

/// A camera looking along −z of `to_world`, +y up.
#[derive(Clone, Debug)]
pub struct CameraDescription {
    /// Name, for `--camera`.
    pub name: String,
    /// Placement; scale is ignored.
    pub to_world: DAffine3,
    /// Projection.
    pub projection: Projection,
}

/// Camera projections.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Vertical field of view in radians; aspect ratio where the file gives one.
    Perspective {
        /// Full vertical angle.
        yfov: f64,
        /// Width / height, where given.
        aspect: Option<f64>,
    },
    /// Half width and half height of the view, in world units.
    Orthographic {
        /// Half width.
        xmag: f64,
        /// Half height.
        ymag: f64,
    },
}
