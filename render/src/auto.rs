//! `--method auto`: which method a scene asks for, and why.
//!
//! A pure function of the scene and of the options that were given. It is asked before a job is prepared, so that
//! [`RenderSettings`](crate::settings::RenderSettings) always name a method.

use crate::error::SettingsError;
use crate::material::Material;
use crate::scene::description::SceneDescription;
use crate::settings::{Layer, Method, Setting, enumerate};

/// The methods from the most to the least generally useful, for when options leave out the one that the scene asks for.
const PREFERENCE: [Method; 7] =
    [Method::Photon, Method::Path, Method::Progressive, Method::Vcm, Method::Bdpt, Method::Mlt, Method::Whitted];

/// A method, and why it was chosen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choice {
    /// The method.
    pub method: Method,
    /// Why.
    pub reason: String,
}

/// What of a scene decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Traits {
    /// Something emits light.
    light: bool,
    /// Some surface has a diffuse lobe: it can hold photons.
    diffuse: bool,
    /// Some surface has a lobe that is not diffuse: it can focus light.
    focusing: bool,
}

/// The methods that use every option in `given` and have every layer in `layers`, the most useful first; never empty.
///
/// # Errors
/// When there is none: names the options that exclude each other, with the methods that use each.
pub fn candidates(given: &[Setting], layers: &[Layer]) -> Result<Vec<Method>, SettingsError> {
    let takes = |m: &Method| m.refuse_unused(given).is_ok() && m.refuse_layers(layers).is_ok();
    let found: Vec<Method> = PREFERENCE.into_iter().filter(|m| Method::ALL.contains(m)).filter(takes).collect();
    if found.is_empty() { Err(conflict(given, layers)) } else { Ok(found) }
}

/// Why no method takes all options: those that not every method uses, each with its methods.
fn conflict(given: &[Setting], layers: &[Layer]) -> SettingsError {
    let users = |takes: &dyn Fn(Method) -> bool| {
        let names: Vec<String> = Method::ALL.into_iter().filter(|&m| takes(m)).map(|m| m.name().into()).collect();
        enumerate(&names)
    };
    let mut parts: Vec<String> =
        given.iter().map(|s| format!("--{} ({})", s.name(), users(&|m| m.options().contains(s)))).collect();
    if !layers.is_empty() {
        let names: Vec<&str> = layers.iter().map(|l| l.name()).collect();
        parts.push(format!("--layers {} ({})", names.join(","), users(&|m| m.refuse_layers(layers).is_ok())));
    }
    SettingsError { setting: "method", message: format!("no method takes all of {}; leave one out", enumerate(&parts)) }
}

/// The method for `scene`, among those that use every option in `given` and have every layer in `layers`.
///
/// # Errors
/// When no method does.
pub fn choose(scene: &SceneDescription, given: &[Setting], layers: &[Layer]) -> Result<Choice, SettingsError> {
    let candidates = candidates(given, layers)?;
    let (wanted, reason) = wanted(traits(scene));
    let choice = |method: Method, reason: String| Ok(Choice { method, reason });
    match candidates.as_slice() {
        found if found.contains(&wanted) => choice(wanted, reason.into()),
        [only] => choice(*only, format!("the only one that takes {}", decisive(given, layers))),
        [first, ..] => {
            let names: Vec<String> = candidates.iter().map(|m| m.name().into()).collect();
            let options = decisive(given, layers);
            choice(*first, format!("of {}, which take {options}, the first to try", enumerate(&names)))
        }
        [] => Err(conflict(given, layers)),
    }
}

/// The options and layers that leave out some method.
fn decisive(given: &[Setting], layers: &[Layer]) -> String {
    let some_lacks = |lacks: &dyn Fn(Method) -> bool| Method::ALL.into_iter().any(lacks);
    let options = given.iter().filter(|s| some_lacks(&|m| !m.options().contains(s)));
    let options = options.map(|s| format!("--{}", s.name()));
    let layers = layers.iter().filter(|l| some_lacks(&|m| !m.layers().contains(l)));
    let layers = layers.map(|l| format!("layer {}", l.name()));
    enumerate(&options.chain(layers).collect::<Vec<_>>())
}

/// What the scene alone asks for.
fn wanted(traits: Traits) -> (Method, &'static str) {
    match traits {
        Traits { light: false, .. } => (Method::Path, "there is no light, so no photons"),
        Traits { diffuse: false, .. } => (Method::Path, "no surface is diffuse, so nothing would hold photons"),
        Traits { focusing: true, .. } => (
            Method::Progressive,
            "specular or glossy surfaces may focus light onto diffuse ones, and every round makes it sharper",
        ),
        Traits { focusing: false, .. } => (
            Method::Photon,
            "all surfaces are diffuse: indirect light is smooth, and one map serves every final gather",
        ),
    }
}

fn traits(scene: &SceneDescription) -> Traits {
    let used: Vec<Material> =
        used_materials(scene).into_iter().map(|m| Material::new(&scene.materials[m], 1.0)).collect();
    let punctual = scene.lights.iter().any(|l| !l.intensity.is_black());
    Traits {
        light: punctual || used.iter().any(Material::is_emissive),
        diffuse: used.iter().any(Material::has_diffuse),
        focusing: used.iter().any(Material::has_specular_or_glossy),
    }
}

/// Indices of the materials of meshes that are placed somewhere, ascending.
fn used_materials(scene: &SceneDescription) -> Vec<usize> {
    let mut used: Vec<usize> = scene
        .instances
        .iter()
        .filter_map(|i| scene.meshes.get(i.mesh))
        .map(|m| m.material as usize)
        .filter(|&m| m < scene.materials.len())
        .collect();
    used.sort_unstable();
    used.dedup();
    used
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Mesh;
    use crate::math::Rgb;
    use crate::scene::description::{InstanceDescription, MaterialDescription};
    use glam::DAffine3;

    /// A scene whose meshes have these materials; the last material is used by none.
    fn scene(materials: &[MaterialDescription]) -> SceneDescription {
        let mut scene = SceneDescription { materials: materials.to_vec(), ..Default::default() };
        scene.materials.push(MaterialDescription::metal("unused", Rgb::WHITE, 0.1));
        for material in 0..materials.len() {
            scene.meshes.push(Mesh { material: material as u32, ..Default::default() });
            scene.instances.push(InstanceDescription { mesh: material, to_world: DAffine3::IDENTITY, name: "".into() });
        }
        scene
    }

    fn wall() -> MaterialDescription {
        MaterialDescription::lambert("wall", Rgb::splat(0.5))
    }
    fn lamp() -> MaterialDescription {
        MaterialDescription::emitter("lamp", Rgb::WHITE)
    }
    fn mirror() -> MaterialDescription {
        MaterialDescription::metal("mirror", Rgb::WHITE, 0.0)
    }

    fn chosen(materials: &[MaterialDescription]) -> (Method, String) {
        let choice = choose(&scene(materials), &[], &[]).unwrap();
        (choice.method, choice.reason)
    }

    #[test]
    fn the_scene_decides_and_says_why() {
        let (method, reason) = chosen(&[wall(), lamp()]);
        assert!(method == Method::Photon && reason.contains("all surfaces are diffuse"), "{reason}");
        let (method, reason) = chosen(&[wall(), lamp(), mirror()]);
        assert!(method == Method::Progressive && reason.contains("focus"), "{reason}");
        let (method, reason) = chosen(&[lamp(), mirror()]);
        assert!(method == Method::Path && reason.contains("no surface is diffuse"), "{reason}");
        let (method, reason) = chosen(&[wall(), mirror()]);
        assert!(method == Method::Path && reason.contains("no light"), "{reason}");
    }

    #[test]
    fn options_of_other_methods_decide_first() {
        let room = scene(&[wall(), lamp()]);
        let choice = choose(&room, &[Setting::MaxDepth, Setting::Samples], &[]).unwrap();
        assert!(choice.method != Method::Photon && choice.reason.contains("--max-depth"), "{choice:?}");
        // The scene would have it otherwise, but only photon mapping has a k.
        let choice = choose(&scene(&[lamp(), mirror()]), &[Setting::K], &[]).unwrap();
        assert_eq!(choice.method, Method::Photon);
        assert!(choice.reason.contains("--k"), "{choice:?}");
    }

    #[test]
    fn options_that_exclude_each_other_are_named_with_their_methods() {
        let error = choose(&scene(&[wall()]), &[Setting::MaxDepth, Setting::K], &[]).unwrap_err().to_string();
        for part in ["--method", "--max-depth (", "path", "--k (photon)", "leave one out"] {
            assert!(error.contains(part), "no {part} in {error}");
        }
    }

    #[test]
    fn candidates_use_every_option_and_are_built() {
        for setting in Setting::ALL {
            for method in candidates(&[setting], &[]).unwrap_or_default() {
                assert!(method.options().contains(&setting) && Method::ALL.contains(&method));
            }
        }
        assert_eq!(candidates(&[], &[]).unwrap()[0], Method::Photon);
        assert!(candidates(&[], Method::Photon.layers()).unwrap().contains(&Method::Path));
        assert_eq!(candidates(&[], &[Layer::Strategies]).unwrap(), [Method::Bdpt]);
        assert!(candidates(&[], &Layer::ALL).is_err());
    }
}
