//! Surface scattering: the BSDF contract and glTF's materials.
//!
//! Contract (after pbrt 4th ed. §9.1 and Mitsuba 3 `bsdf.h`):
//! - `wo` and `wi` are unit and point away from the surface. In [`TransportMode::Radiance`] `wo` points to where the
//!   radiance goes (the camera side), in [`TransportMode::Importance`] to where the photon came from; the sampled
//!   direction is always `wi`.
//! - `eval` leaves out the cosine and every Dirac lobe; `pdf` is per solid angle and leaves out Dirac lobes too.
//! - `sample` returns `weight = f·|cos θi| / pdf` of the lobe set asked for (for a Dirac lobe: its coefficient divided by
//!   the probability of choosing it), and the pdf of all non-Dirac lobes of that set, so that MIS can be applied.
//! - cosines are taken with the shading normal; whether a direction reflects or transmits is decided by the geometric
//!   normal. Photons and light paths carry the adjoint correction of Veach 1997 §5.3
//!   ([`Scatter::importance_correction`]).
//! - radiance is scaled by η² at refraction in `Radiance` mode and not in `Importance` mode.

pub mod albedo;
pub mod bsdf;
pub mod compiled;
pub mod fresnel;
pub mod glass;
pub mod lambert;
pub mod layered;
pub mod lobes;
pub mod microfacet;
pub mod scatter;
pub mod texture;

pub use bsdf::Bsdf;
pub use compiled::Material;
pub use lambert::Lambert;
pub use lobes::Lobes;
pub use scatter::{BsdfSample, Scatter};
pub use texture::Textures;

/// Which quantity travels along the sampled path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TransportMode {
    /// Paths from the camera carry radiance backwards.
    Radiance,
    /// Paths from lights (photons) carry importance backwards, power forwards.
    Importance,
}

impl TransportMode {
    /// The mode of paths that run the other way.
    #[inline]
    pub const fn reversed(self) -> TransportMode {
        match self {
            TransportMode::Radiance => TransportMode::Importance,
            TransportMode::Importance => TransportMode::Radiance,
        }
    }
}

#[cfg(test)]
mod tests;
