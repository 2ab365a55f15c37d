//! What one camera sample finds.

use crate::material::Lobes;
use crate::math::Rgb;
use glam::Vec3;

/// Radiance of one camera sample, in its three parts, and what its first hit is.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample {
    /// Radiance by `E(S|G)*L` and `E(S|G)*DL`.
    pub direct: Rgb,
    /// Radiance by further diffuse bounces.
    pub indirect: Rgb,
    /// Radiance focused onto the first diffuse surface.
    pub caustic: Rgb,
    /// The first surface; `None` where the ray left the scene.
    pub first: Option<FirstHit>,
    /// Rays traced.
    pub rays: u32,
}

impl Sample {
    /// All light.
    #[inline]
    pub fn radiance(&self) -> Rgb {
        self.direct + self.indirect + self.caustic
    }
    /// Adds `value` to the part that `stage` names.
    #[inline]
    pub fn add(&mut self, part: Part, value: Rgb) {
        match part {
            Part::Direct => self.direct += value,
            Part::Indirect => self.indirect += value,
            Part::Caustic => self.caustic += value,
        }
    }
}

/// The first surface a camera ray meets.
#[derive(Clone, Copy, Debug)]
pub struct FirstHit {
    /// Scene-space position.
    pub position: Vec3,
    /// Shading normal towards the camera.
    pub normal: Vec3,
    /// Reflectance.
    pub albedo: Rgb,
}

/// The parts of [`Sample`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// See [`Sample::direct`].
    Direct,
    /// See [`Sample::indirect`].
    Indirect,
    /// See [`Sample::caustic`].
    Caustic,
}

/// How far a camera path has come, as far as the partition of light needs it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Stage {
    /// `E(S|G)*`.
    #[default]
    BeforeDiffuse,
    /// `E(S|G)*D`.
    AfterDiffuse,
    /// `E(S|G)*D(S|G)⁺`.
    FocusedAfterDiffuse,
    /// `E…D…D…`.
    Later,
}

impl Stage {
    /// The stage after scattering by a lobe of kind `lobe`.
    #[inline]
    pub fn after(self, lobe: Lobes) -> Stage {
        let diffuse = lobe == Lobes::DIFFUSE;
        match (self, diffuse) {
            (Stage::BeforeDiffuse, false) => Stage::BeforeDiffuse,
            (Stage::BeforeDiffuse, true) => Stage::AfterDiffuse,
            (Stage::AfterDiffuse | Stage::FocusedAfterDiffuse, false) => Stage::FocusedAfterDiffuse,
            _ => Stage::Later,
        }
    }
    /// The part that emission belongs to when a path in this stage meets a light.
    #[inline]
    pub fn part(self) -> Part {
        match self {
            Stage::BeforeDiffuse | Stage::AfterDiffuse => Part::Direct,
            Stage::FocusedAfterDiffuse => Part::Caustic,
            Stage::Later => Part::Indirect,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_path_has_its_part() {
        let part = |path: &str| {
            path.chars()
                .fold(Stage::default(), |s, c| {
                    s.after(match c {
                        'D' => Lobes::DIFFUSE,
                        'G' => Lobes::GLOSSY,
                        _ => Lobes::SPECULAR,
                    })
                })
                .part()
        };
        for p in ["", "S", "SG", "D", "SSD"] {
            assert_eq!(part(p), Part::Direct, "{p}");
        }
        for p in ["DS", "DG", "SDSG"] {
            assert_eq!(part(p), Part::Caustic, "{p}");
        }
        for p in ["DD", "DSD", "DDS", "SDGD"] {
            assert_eq!(part(p), Part::Indirect, "{p}");
        }
    }
}
