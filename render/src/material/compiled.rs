//! Materials compiled from their description.

use super::bsdf::Layers;
use super::glass::Glass;
use super::layered::{Coat, Reflection};
use super::microfacet::ALPHA_RESOLVED;
use super::texture::Encoding;
use super::{Bsdf, Lambert, Textures};
use crate::geometry::SurfacePoint;
use crate::math::Rgb;
use crate::math::ops::{exp, ln};
use crate::scene::description::MaterialDescription;
use glam::{Vec2, Vec3};

/// Smallest cosine a normal-mapped normal keeps with the geometric one.
const MIN_NORMAL_COSINE: f32 = 1e-3;

/// A glTF material, ready to shade.
#[derive(Clone, Debug)]
pub struct Material {
    d: MaterialDescription,
    /// σ_a per scene unit, where the material bounds an absorbing body.
    absorption: Option<Rgb>,
    /// Nothing but a Lambertian base, whatever the textures say.
    pure_lambert: bool,
}

/// The numbers of a material at one point, textures applied.
struct Inputs {
    base: Rgb,
    metallic: f32,
    alpha: f32,
    transmission: f32,
    specular: f32,
    specular_color: Rgb,
}

impl Material {
    /// Compiles `description`. `scene_scale` is scene units per unit of the file (an exact power of two).
    pub fn new(description: &MaterialDescription, scene_scale: f32) -> Material {
        let d = description.clone();
        let absorbs = d.volume && d.transmission > 0.0 && d.attenuation_distance.is_finite();
        let absorption = (absorbs && d.attenuation_color != Rgb::WHITE).then(|| {
            // A black channel would need an infinite coefficient; 1e-30 after one distance is black enough.
            let distance = (d.attenuation_distance * scene_scale).max(f32::MIN_POSITIVE);
            d.attenuation_color.map(|c| (-ln(c.clamp(1e-30, 1.0)) / distance).min(f32::MAX))
        });
        let pure_lambert = d.metallic == 0.0 && d.specular == 0.0 && d.transmission == 0.0;
        Material { d, absorption, pure_lambert }
    }

    /// The material's name.
    pub fn name(&self) -> &str {
        &self.d.name
    }

    /// The BSDF at `point`.
    #[inline]
    pub fn bsdf(&self, point: &SurfacePoint, textures: &Textures) -> Bsdf {
        let ns = match self.d.normal_texture {
            None => point.ns,
            Some(_) => self.mapped_normal(point, textures),
        };
        if self.pure_lambert {
            return Lambert::new(point.ng, ns, self.base_color(point, textures)).into();
        }
        self.layered(point.ng, ns, &self.inputs(point, textures))
    }

    /// Base colour of a material without textures where vertices have no colour.
    #[inline]
    pub fn plain_color(&self) -> Rgb {
        self.d.base_color.clamp01()
    }
    /// A bare Lambertian surface of one colour, without normal map, whose emission is the same everywhere.
    pub fn is_plain(&self) -> bool {
        let d = &self.d;
        let is_mapped = [d.base_color_texture, d.normal_texture, d.emissive_texture].iter().any(Option::is_some);
        self.pure_lambert && !is_mapped
    }

    /// Base colour with texture and vertex colour.
    #[inline]
    fn base_color(&self, point: &SurfacePoint, textures: &Textures) -> Rgb {
        let c = point.color;
        let mut base = self.d.base_color * Rgb::new(c[0], c[1], c[2]);
        if let Some(t) = self.d.base_color_texture {
            let v = textures.sample(t, &point.uv, Encoding::Srgb);
            base *= Rgb::new(v[0], v[1], v[2]);
        }
        base.clamp01()
    }

    fn inputs(&self, point: &SurfacePoint, textures: &Textures) -> Inputs {
        let d = &self.d;
        let read = |t, e| textures.sample(t, &point.uv, e);
        let (mut metallic, mut roughness) = (d.metallic, d.roughness);
        if let Some(t) = d.metallic_roughness_texture {
            let v = read(t, Encoding::Linear);
            roughness *= v[1];
            metallic *= v[2];
        }
        let transmission = d.transmission * d.transmission_texture.map_or(1.0, |t| read(t, Encoding::Linear)[0]);
        let specular = d.specular * d.specular_texture.map_or(1.0, |t| read(t, Encoding::Linear)[3]);
        let mut specular_color = d.specular_color;
        if let Some(t) = d.specular_color_texture {
            let v = read(t, Encoding::Srgb);
            specular_color *= Rgb::new(v[0], v[1], v[2]);
        }
        let alpha = roughness * roughness;
        let base = self.base_color(point, textures);
        Inputs { base, metallic, alpha, transmission, specular, specular_color }
    }

    /// Assembles the lobes: (1 − m)·[(1 − t)·coated base + t·glass] + m·metal.
    fn layered(&self, ng: Vec3, ns: Vec3, i: &Inputs) -> Bsdf {
        let alpha = if i.alpha < ALPHA_RESOLVED { 0.0 } else { i.alpha.min(1.0) };
        let opaque = (1.0 - i.metallic) * (1.0 - i.transmission);
        let r0 = (self.d.ior - 1.0) / (self.d.ior + 1.0);
        // KHR_materials_specular: F0 = min(F0_ior · colour, 1) · factor, F90 = factor.
        let coat_f0 = (i.specular_color * (r0 * r0)).clamp01() * i.specular;
        let f0 = coat_f0 * opaque + i.base * i.metallic;
        let f90 = Rgb::splat(i.specular * opaque + i.metallic);
        let reflection = (f90.r > 0.0).then_some(Reflection { f0, f90, alpha });
        let diffuse = i.base * opaque;
        let coat = if diffuse.is_black() || i.specular == 0.0 {
            Coat::NONE
        } else {
            Coat::new(coat_f0.max_component(), i.specular, alpha)
        };
        let weight = (1.0 - i.metallic) * i.transmission;
        let thin = !self.d.volume;
        let glass = (weight > 0.0).then(|| Glass {
            weight,
            tint: i.base,
            ior: self.d.ior.max(1.0),
            thin,
            alpha: Glass::effective_alpha(alpha, self.d.ior, thin),
        });
        if reflection.is_none() && glass.is_none() {
            return Lambert::new(ng, ns, diffuse).into();
        }
        Bsdf::layered(Lambert::new(ng, ns, diffuse), Layers { coat, reflection, glass })
    }

    /// Shading normal from the normal map, kept in the hemisphere of the geometric normal.
    fn mapped_normal(&self, point: &SurfacePoint, textures: &Textures) -> Vec3 {
        let (Some(map), Some((tangent, handedness))) = (self.d.normal_texture, point.tangent) else { return point.ns };
        let v = textures.sample(map, &point.uv, Encoding::Linear);
        let s = self.d.normal_scale;
        let (x, y, z) = ((2.0 * v[0] - 1.0) * s, (2.0 * v[1] - 1.0) * s, 2.0 * v[2] - 1.0);
        // MikkTSpace: bitangent = handedness · n × t, nothing normalised before the sum.
        let bitangent = point.ns.cross(tangent) * handedness;
        let n = (tangent * x + bitangent * y + point.ns * z).normalize_or(point.ns);
        let c = n.dot(point.ng);
        if c >= MIN_NORMAL_COSINE {
            return n;
        }
        // A normal that turned below the surface is lifted to its horizon.
        (n + point.ng * (MIN_NORMAL_COSINE - c)).normalize_or(point.ng)
    }

    /// Radiance emitted towards `wo`: from the front face, or from both where the material is double-sided.
    #[inline]
    pub fn emission(&self, point: &SurfacePoint, textures: &Textures, wo: Vec3) -> Rgb {
        if !self.is_emissive() || !(self.d.double_sided || wo.dot(point.ng) > 0.0) {
            return Rgb::BLACK;
        }
        self.emission_at(&point.uv, textures)
    }

    /// Radiance emitted at the texture coordinates, from a face that emits.
    #[inline]
    pub fn emission_at(&self, uv: &[Vec2; 2], textures: &Textures) -> Rgb {
        match self.d.emissive_texture {
            None => self.d.emission,
            Some(t) => {
                let v = textures.sample(t, uv, Encoding::Srgb);
                self.d.emission * Rgb::new(v[0], v[1], v[2])
            }
        }
    }

    /// Whether a point with these texture coordinates and vertex colour is there at all (alpha mask).
    #[inline]
    pub fn alpha_passes(&self, uv: &[Vec2; 2], color: &[f32; 4], textures: &Textures) -> bool {
        let Some(cutoff) = self.d.alpha_cutoff else { return true };
        let texture = self.d.base_color_texture.map_or(1.0, |t| textures.sample(t, uv, Encoding::Srgb)[3]);
        self.d.base_alpha * color[3] * texture >= cutoff
    }

    /// Absorption coefficient σ_a per scene unit inside the body this material bounds.
    #[inline]
    pub fn absorption(&self) -> Option<Rgb> {
        self.absorption
    }
    /// Beer–Lambert transmittance exp(−σ_a·distance) over `distance` scene units inside.
    #[inline]
    pub fn transmittance(&self, distance: f32) -> Rgb {
        self.absorption.map_or(Rgb::WHITE, |s| s.map(|v| exp(-v * distance)))
    }

    /// Emits somewhere, as far as its factors say.
    #[inline]
    pub fn is_emissive(&self) -> bool {
        !self.d.emission.is_black()
    }
    /// Emits from both faces.
    #[inline]
    pub fn is_double_sided(&self) -> bool {
        self.d.double_sided
    }
    /// Emission varies over the surface, by its texture or an alpha mask.
    pub fn has_varying_emission(&self) -> bool {
        self.d.emissive_texture.is_some() || self.has_alpha_mask()
    }
    /// Texels of the emissive texture, where there is one.
    pub fn emission_resolution(&self, textures: &Textures) -> Option<[u32; 2]> {
        self.d.emissive_texture.map(|t| textures.resolution(t))
    }
    /// Whether some point whose texture coordinates lie within the box from `min` to `max` may emit.
    pub fn may_emit_within(&self, min: Vec2, max: Vec2, textures: &Textures) -> bool {
        let textured = self.d.emissive_texture.is_none_or(|t| !textures.is_black_within(t, min, max));
        self.is_emissive() && textured
    }
    /// The emitted radiance before textures.
    pub fn emission_factor(&self) -> Rgb {
        self.d.emission
    }
    /// The texture coordinate set of the emissive texture.
    pub fn emission_uv_set(&self) -> usize {
        self.d.emissive_texture.map_or(0, |t| t.uv_set.min(1))
    }
    /// Holes are cut by alpha.
    #[inline]
    pub fn has_alpha_mask(&self) -> bool {
        self.d.alpha_cutoff.is_some()
    }
    /// May have a Lambertian lobe somewhere.
    pub fn has_diffuse(&self) -> bool {
        let m = self.d.metallic < 1.0 || self.d.metallic_roughness_texture.is_some();
        let t = self.d.transmission < 1.0 || self.d.transmission_texture.is_some();
        m && t && !self.d.base_color.is_black()
    }
    /// May have a lobe that is not Lambertian somewhere.
    pub fn has_specular_or_glossy(&self) -> bool {
        !self.pure_lambert
    }
    /// A bare Lambertian surface everywhere.
    #[inline]
    pub fn is_pure_lambert(&self) -> bool {
        self.pure_lambert
    }
    /// Its diffuse lobe weighs the direction light comes from (a coat), so that photons need one.
    pub fn needs_direction(&self) -> bool {
        self.has_diffuse() && self.d.specular > 0.0
    }
    /// Rough upper bound in [0, 1] of what is reflected or transmitted by lobes that are not Lambertian.
    pub fn specular_albedo_bound(&self) -> f32 {
        if self.pure_lambert {
            return 0.0;
        }
        let d = &self.d;
        let r0 = (d.ior - 1.0) / (d.ior + 1.0);
        // Schlick's cosine-weighted mean: F0 + (F90 − F0)/21.
        let f0 = (d.specular_color.max_component() * r0 * r0).min(1.0) * d.specular;
        let coat = f0 + (d.specular - f0) / 21.0;
        let base = d.base_color.max_component();
        let metal = base + (1.0 - base) / 21.0;
        (d.metallic * metal).max(coat.max(d.transmission)).clamp(0.0, 1.0)
    }
}
