//! Errors a caller can act upon. Each says what was wrong, where, and what to do.

use thiserror::Error;

/// Why a scene could not be loaded or built.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SceneError {
    /// The file is not what it claims to be, or is damaged; `place` names the spot (file, JSON path, node or material).
    #[error("{place}: {message}")]
    Invalid {
        /// Where in the file, e.g. `lamp.glb: accessors[3].byteOffset` or `node "Lid"`.
        place: String,
        /// What is wrong there and, where it helps, what to do.
        message: String,
    },
    /// The file requires a glTF extension that is not supported.
    #[error(
        "{place}: the file requires the glTF extension {extension}, which is not supported; re-export it without, or as optional"
    )]
    UnsupportedExtension {
        /// The file's name.
        place: String,
        /// The extension's name.
        extension: String,
    },
    /// A named limit was exceeded.
    #[error("{place}: {what} is {actual}, over the limit of {limit}; {remedy}")]
    Limit {
        /// Where in the file.
        place: String,
        /// The quantity that is too large.
        what: String,
        /// Its value.
        actual: u64,
        /// The limit.
        limit: u64,
        /// How to raise the limit or get below it.
        remedy: String,
    },
}

impl SceneError {
    /// An [`SceneError::Invalid`] at `place`.
    pub fn invalid(place: impl Into<String>, message: impl Into<String>) -> Self {
        SceneError::Invalid { place: place.into(), message: message.into() }
    }
}

/// A render setting that makes no sense; the message names the setting and its valid range.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("--{setting}: {message}")]
pub struct SettingsError {
    /// The setting's command-line name without dashes.
    pub setting: &'static str,
    /// What is wrong and what is valid.
    pub message: String,
}

/// Why an image could not be encoded or decoded.
#[derive(Debug, Error)]
pub enum ImageError {
    /// The file could not be read or written as EXR.
    #[error("EXR: {0}")]
    Exr(String),
    /// The PNG preview could not be encoded.
    #[error("PNG: {0}")]
    Png(String),
    /// Two images that should be compared differ in size or channels.
    #[error("images differ in shape: {0}")]
    Shape(String),
}
