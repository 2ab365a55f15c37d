//! Wire ↔ domain, and nothing else in the project converts: `From` for domain → wire, `TryFrom` for wire → domain,
//! which checks everything a peer could get wrong.

mod collective;
mod job;
mod message;
mod relay;
mod scene;
mod settings;

#[cfg(test)]
mod tests;

pub(crate) use job::{micros, millis};

use crate::error::WireError;
use crate::limits::MAX_NAME_BYTES;
use crate::wire;
use gatherlight_render::photon::MapKind;

/// A required sub-message.
fn required<T>(field: &'static str, value: Option<T>) -> Result<T, WireError> {
    value.ok_or(WireError::Missing(field))
}

/// A bounded text that a terminal or log may show.
fn name(field: &'static str, text: String) -> Result<String, WireError> {
    WireError::check_limit(field, text.len() as u64, MAX_NAME_BYTES as u64, "MAX_NAME_BYTES")?;
    if text.chars().any(char::is_control) {
        return Err(WireError::invalid(field, "has control characters"));
    }
    Ok(text)
}

impl From<MapKind> for wire::MapKind {
    fn from(kind: MapKind) -> Self {
        match kind {
            MapKind::Global => wire::MapKind::Global,
            MapKind::Caustic => wire::MapKind::Caustic,
        }
    }
}

pub(crate) fn map_kind(value: i32) -> Result<MapKind, WireError> {
    match wire::MapKind::try_from(value) {
        Ok(wire::MapKind::Global) => Ok(MapKind::Global),
        Ok(wire::MapKind::Caustic) => Ok(MapKind::Caustic),
        _ => Err(WireError::invalid("map", format!("{value} is no map kind"))),
    }
}
