//! KHR_lights_punctual.

use super::document::{Document, Warnings};
use super::json::{Item, Result, quoted};
use super::nodes::Placement;
use crate::math::Rgb;
use crate::scene::description::{LightDescription, LightKind};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

const EXTENSION: &str = "KHR_lights_punctual";

/// Lights in the order of their nodes.
///
/// # Errors
/// Names the light whose numbers make no sense.
pub(super) fn read_all(
    doc: &Document,
    placements: &[Placement],
    warnings: &mut Warnings,
) -> Result<Vec<LightDescription>> {
    let mut lights = Vec::new();
    for placement in placements {
        let node = doc.item("nodes", placement.node)?;
        let Some(reference) = node.extension(EXTENSION)? else { continue };
        let reference = reference.require("light")?;
        let list = doc.root().extension(EXTENSION)?.map_or(Ok(None), |e| e.get("lights"))?;
        let list =
            list.ok_or_else(|| reference.error(format!("the file lists no lights under extensions.{EXTENSION}")))?;
        let item = list.at(reference.size()?).ok_or_else(|| {
            let count = list.values().map_or(0, <[_]>::len);
            reference.error(format!("refers to light {}, but there are {count}", reference.unsigned().unwrap_or(0)))
        })?;
        let own = item.opt("name", Item::text)?.unwrap_or("");
        let name = [doc.name("nodes", placement.node), own].into_iter().find(|n| !n.is_empty());
        let name = name.map_or_else(|| format!("lights[{}]", reference.unsigned().unwrap_or(0)), str::to_owned);
        let light = read(&item, name, placement, warnings)?;
        let determinant = placement.to_world.matrix3.determinant();
        if light.kind != LightKind::Point && (determinant == 0.0 || !determinant.is_finite()) {
            return Err(node.error("carries a light, but its transform has no direction left (scale of zero)"));
        }
        lights.push(light);
    }
    Ok(lights)
}

fn read(item: &Item, name: String, placement: &Placement, warnings: &mut Warnings) -> Result<LightDescription> {
    let kind_item = item.require("type")?;
    let kind = match kind_item.text()? {
        "point" => LightKind::Point,
        "directional" => LightKind::Directional,
        "spot" => spot(item)?,
        _ => return Err(kind_item.error("must be \"point\", \"spot\" or \"directional\"")),
    };
    let color = item.opt("color", Item::floats::<3>)?.unwrap_or([1.0; 3]);
    let intensity = item.opt("intensity", Item::float)?.unwrap_or(1.0);
    let power = Rgb::from(color) * intensity;
    if color.iter().any(|c| *c < 0.0) || intensity < 0.0 || !power.is_finite() {
        return Err(item.error(format!("color {color:?} × intensity {intensity} must be finite and not negative")));
    }
    if item.get("range")?.is_some() {
        warnings.add(format!(
            "light {}: its range is ignored; light falls off with the square of the distance without end",
            quoted(&name)
        ));
    }
    Ok(LightDescription { name, to_world: placement.to_world, intensity: power, kind })
}

fn spot(item: &Item) -> Result<LightKind> {
    let cone = item.get("spot")?;
    let angle = |key: &str, default: f64| -> Result<f64> {
        Ok(cone.as_ref().map_or(Ok(None), |c| c.opt(key, Item::number))?.unwrap_or(default))
    };
    let (inner, outer) = (angle("innerConeAngle", 0.0)?, angle("outerConeAngle", FRAC_PI_4)?);
    // Exporters write π/2 in single precision, which is 4e-8 above it.
    let outer = if outer > FRAC_PI_2 && outer - FRAC_PI_2 < 1e-6 { FRAC_PI_2 } else { outer };
    if !(0.0 <= inner && inner < outer && outer <= FRAC_PI_2) {
        return Err(item.error(format!("spot angles must satisfy 0 ≤ inner < outer ≤ π/2, found {inner} and {outer}")));
    }
    Ok(LightKind::Spot { inner, outer })
}
