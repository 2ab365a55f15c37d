//! Images as files: EXR and a PNG preview, as bytes.
