//! URIs of buffers and images: data URIs decoded, the others found in the bundle.

use super::json::{Item, Result, quoted};
use base64::Engine as _;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use std::borrow::Cow;

/// What `data:` URIs in the wild contain: standard alphabet, with or without padding.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// True for `data:…`.
pub(super) fn is_data(uri: &str) -> bool {
    uri.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:"))
}

/// Media type and bytes of a data URI (RFC 2397).
///
/// # Errors
/// When the comma is missing or the base64 is damaged.
pub(super) fn decode_data<'a>(item: &Item<'a>, uri: &'a str) -> Result<(&'a str, Vec<u8>)> {
    let (head, payload) = uri
        .get(5..)
        .and_then(|rest| rest.split_once(','))
        .ok_or_else(|| item.error("the data URI has no comma before its data"))?;
    let (media, bytes) = match head.strip_suffix(";base64") {
        Some(media) => (media, BASE64.decode(payload).map_err(|e| item.error(format!("the base64 is damaged: {e}")))?),
        None => (head, percent_decode(payload).into_owned()),
    };
    Ok((media.split(';').next().unwrap_or(""), bytes))
}

/// Replaces %XX by its byte.
fn percent_decode(text: &str) -> Cow<'_, [u8]> {
    if !text.contains('%') {
        return Cow::Borrowed(text.as_bytes());
    }
    let bytes = text.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut i = 0;
    while let Some(&byte) = bytes.get(i) {
        let hex = bytes.get(i + 1..i + 3).and_then(|h| std::str::from_utf8(h).ok());
        let hex = hex.filter(|h| byte == b'%' && h.chars().all(|c| c.is_ascii_hexdigit()));
        match hex.and_then(|h| u8::from_str_radix(h, 16).ok()) {
            Some(decoded) => {
                out.push(decoded);
                i += 3;
            }
            None => {
                out.push(byte);
                i += 1;
            }
        }
    }
    Cow::Owned(out)
}

/// The path, relative to the scene file, that a URI from [`super::external_uris`] names: percent-decoded. `None` for a
/// URI with a scheme (`http:` …), which this renderer does not fetch, and for bytes that are not UTF-8.
pub fn relative_path(uri: &str) -> Option<String> {
    let scheme = uri.split_once(':').is_some_and(|(s, _)| {
        s.len() > 1 && s.starts_with(|c: char| c.is_ascii_alphabetic()) && s.chars().all(|c| c.is_ascii_alphanumeric())
    });
    if scheme { None } else { String::from_utf8(percent_decode(uri).into_owned()).ok() }
}

/// Number and bytes of the external file `uri`.
///
/// # Errors
/// When the bundle lacks it.
pub(super) fn find_external<'b>(
    item: &Item,
    uri: &str,
    externals: &'b [(String, std::sync::Arc<[u8]>)],
) -> Result<(usize, &'b [u8])> {
    let found = externals.iter().enumerate().find(|(_, (name, _))| name == uri);
    found.map(|(at, (_, bytes))| (at, &**bytes)).ok_or_else(|| {
        let hint = if relative_path(uri).is_none() {
            "; only files beside the scene are read, not network addresses"
        } else {
            ""
        };
        item.error(format!("the external file {} is missing{hint}", quoted(uri)))
    })
}
