//! Kernels on the disc: how a photon's weight falls with its distance from the centre.
//!
//! Each integrates to 1 over the disc of the gather radius. With the radius set by the k-th nearest photon, that photon is
//! left out of the sum (García et al. 2012): given its distance the other k − 1 are spread like a Poisson process on the
//! disc, so Σ over k − 1 photons of a kernel of integral 1 has mean (k − 1)/(π r²), and E[(k − 1)/(π r_k²)] is exactly the
//! density. Cone and Epanechnikov kernels vanish at the rim by themselves.

use crate::math::ops::INV_PI;
pub use crate::settings::Kernel;

impl Kernel {
    /// Weight per area of a photon at squared distance `distance_squared` in a disc of squared radius `radius_squared`;
    /// 0 outside, and 0 for every kernel but the constant one at the rim.
    ///
    /// Units: 1/area of the scene space. `radius_squared` > 0.
    #[inline(always)]
    pub fn weight(self, distance_squared: f32, radius_squared: f32) -> f32 {
        self.normalisation(radius_squared) * self.shape(distance_squared / radius_squared)
    }

    /// The factor that makes the kernel integrate to 1 over the disc, 1/area.
    #[inline(always)]
    pub fn normalisation(self, radius_squared: f32) -> f32 {
        let inverse_area = INV_PI / radius_squared;
        match self {
            Kernel::Constant => inverse_area,
            Kernel::Cone => 3.0 * inverse_area,
            Kernel::Epanechnikov => 2.0 * inverse_area,
        }
    }

    /// Mean of distance² over radius², weighted by the kernel: what the blur of smooth light is in proportion to (Silverman 1986, §4.2).
    pub fn second_moment(self) -> f32 {
        match self {
            Kernel::Constant => 1.0 / 2.0,
            Kernel::Cone => 3.0 / 10.0,
            Kernel::Epanechnikov => 1.0 / 3.0,
        }
    }

    /// The kernel's shape, 1 at the centre, at squared distance / squared radius = `t` ≥ 0.
    #[inline(always)]
    pub fn shape(self, t: f32) -> f32 {
        match self {
            Kernel::Constant => f32::from(t <= 1.0),
            Kernel::Cone => (1.0 - t.sqrt()).max(0.0),
            Kernel::Epanechnikov => (1.0 - t).max(0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) const ALL: [Kernel; 3] = [Kernel::Constant, Kernel::Cone, Kernel::Epanechnikov];

    #[test]
    fn each_integrates_to_one_over_the_disc() {
        for kernel in ALL {
            for radius in [1e-4f64, 0.3, 1.0, 7.0] {
                // Midpoint rule over rings of equal area.
                let n = 100_000;
                let sum: f64 = (0..n)
                    .map(|i| {
                        let d2 = (f64::from(i) + 0.5) / f64::from(n) * radius * radius;
                        f64::from(kernel.weight(d2 as f32, (radius * radius) as f32))
                    })
                    .sum();
                let integral = sum / f64::from(n) * std::f64::consts::PI * radius * radius;
                assert!((integral - 1.0).abs() < 1e-5, "{kernel:?} {radius} {integral}");
            }
        }
    }

    #[test]
    fn second_moments_are_those_of_the_weights() {
        for kernel in ALL {
            let n = 100_000;
            let ring = |i: i32| (f64::from(i) + 0.5) / f64::from(n);
            let sum: f64 = (0..n).map(|i| ring(i) * f64::from(kernel.weight(ring(i) as f32, 1.0))).sum();
            let moment = sum / f64::from(n) * std::f64::consts::PI;
            assert!((moment - f64::from(kernel.second_moment())).abs() < 1e-4, "{kernel:?} {moment}");
        }
    }

    #[test]
    fn shapes_are_one_at_the_centre_and_nothing_lies_outside() {
        for kernel in ALL {
            assert_eq!(kernel.shape(0.0), 1.0);
            assert_eq!(kernel.shape(1.000_001), 0.0);
            assert!(kernel == Kernel::Constant || kernel.shape(1.0) == 0.0);
        }
    }
}
