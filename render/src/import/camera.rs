//! Cameras of the selected scene, one for each node that carries one.

use super::document::{Document, Warnings};
use super::json::{Item, Result};
use super::nodes::Placement;
use crate::scene::description::{CameraDescription, Projection};

/// Cameras in the order of their nodes.
///
/// # Errors
/// Names the camera whose numbers make no view.
pub(super) fn read_all(
    doc: &Document,
    placements: &[Placement],
    warnings: &mut Warnings,
) -> Result<Vec<CameraDescription>> {
    let mut cameras = Vec::new();
    for placement in placements {
        let node = doc.item("nodes", placement.node)?;
        let Some(index) = doc.reference(&node, "camera", "cameras")? else { continue };
        let item = doc.item("cameras", index)?;
        let determinant = placement.to_world.matrix3.determinant();
        if determinant == 0.0 || !determinant.is_finite() {
            return Err(node.error("carries a camera, but its transform has no direction left (scale of zero)"));
        }
        let name = [doc.name("nodes", placement.node), doc.name("cameras", index)].into_iter().find(|n| !n.is_empty());
        cameras.push(CameraDescription {
            name: name.map_or_else(|| format!("cameras[{index}]"), str::to_owned),
            to_world: placement.to_world,
            projection: projection(doc, &item, index, warnings)?,
        });
    }
    Ok(cameras)
}

fn projection(doc: &Document, item: &Item, index: usize, warnings: &mut Warnings) -> Result<Projection> {
    let kind = item.require("type")?;
    match kind.text()? {
        "perspective" => {
            let lens = item.require("perspective")?;
            let yfov_item = lens.require("yfov")?;
            let yfov = yfov_item.number()?;
            if !(yfov > 0.0 && yfov < std::f64::consts::PI) {
                return Err(yfov_item.error(format!("must lie between 0 and π radians, found {yfov}")));
            }
            let aspect = lens.opt("aspectRatio", positive)?;
            Ok(Projection::Perspective { yfov, aspect })
        }
        "orthographic" => {
            let lens = item.require("orthographic")?;
            let half = |key: &str| -> Result<f64> {
                let value = lens.require(key)?;
                match value.number()? {
                    0.0 => Err(value.error("must not be zero")),
                    v => Ok(v),
                }
            };
            let (xmag, ymag) = (half("xmag")?, half("ymag")?);
            if xmag < 0.0 || ymag < 0.0 {
                let name = doc.label("camera", "cameras", index);
                warnings.add(format!(
                    "{name}: negative xmag or ymag would mirror the view; its size is used without the sign"
                ));
            }
            Ok(Projection::Orthographic { xmag: xmag.abs(), ymag: ymag.abs() })
        }
        _ => Err(kind.error("must be \"perspective\" or \"orthographic\"")),
    }
}

fn positive(item: &Item) -> Result<f64> {
    match item.number()? {
        v if v > 0.0 => Ok(v),
        v => Err(item.error(format!("must be above 0, found {v}"))),
    }
}
