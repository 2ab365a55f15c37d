//! JSON values that know where they stand in the file, so that every error names the place.
//!
//! The typed JSON layer of the `gltf` crate is not used: it reads node matrices in single precision, takes indices
//! modulo 2³², and cannot say where a value stands.

use super::limits::{MAX_JSON_BYTES, MAX_JSON_VALUES, MAX_QUOTED_CHARS};
use crate::error::SceneError;
use serde_json::Value;

/// Result of everything in this module's neighbourhood.
pub(super) type Result<T> = std::result::Result<T, SceneError>;

/// Parses `bytes` of the file called `file`.
///
/// # Errors
/// When the text is too large, or not JSON (with line and column), or nested deeper than 128 levels.
pub(super) fn parse(file: &str, bytes: &[u8]) -> Result<Value> {
    let over = |what: &str, actual: usize, limit: usize, remedy: &str| SceneError::Limit {
        place: file.into(),
        what: what.into(),
        actual: actual as u64,
        limit: limit as u64,
        remedy: remedy.into(),
    };
    if bytes.len() > MAX_JSON_BYTES {
        return Err(over(
            "the number of JSON bytes",
            bytes.len(),
            MAX_JSON_BYTES,
            "store buffers in a .glb or in .bin files instead of data URIs",
        ));
    }
    let values = upper_bound_of_values(bytes);
    if values > MAX_JSON_VALUES {
        return Err(over("the number of JSON values", values, MAX_JSON_VALUES, "split the scene or join its nodes"));
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    serde_json::from_slice(text).map_err(|e| SceneError::invalid(file, format!("the JSON is damaged: {e}")))
}

/// Every value but the first follows one of these bytes; those inside strings only raise the bound.
fn upper_bound_of_values(bytes: &[u8]) -> usize {
    1 + bytes.iter().filter(|b| matches!(b, b',' | b'[' | b'{' | b':')).count()
}

/// A name or URI from the file as it appears in messages: quoted, control characters escaped, shortened.
pub(super) fn quoted(text: &str) -> String {
    let mut shown: String = text.chars().take(MAX_QUOTED_CHARS).collect();
    if shown.len() < text.len() {
        shown.push('…');
    }
    format!("{shown:?}")
}

/// A JSON value with its place.
#[derive(Clone)]
pub(super) struct Item<'a> {
    file: &'a str,
    path: String,
    value: &'a Value,
}

impl<'a> Item<'a> {
    /// The whole document.
    pub(super) fn root(file: &'a str, value: &'a Value) -> Self {
        Item { file, path: String::new(), value }
    }
    /// `file: path`.
    pub(super) fn place(&self) -> String {
        if self.path.is_empty() { self.file.into() } else { format!("{}: {}", self.file, self.path) }
    }
    /// `path` within the file.
    pub(super) fn path(&self) -> &str {
        &self.path
    }
    /// The value without its place.
    pub(super) fn raw(&self) -> &'a Value {
        self.value
    }
    /// An error at this place.
    pub(super) fn error(&self, message: impl Into<String>) -> SceneError {
        SceneError::invalid(self.place(), message)
    }
    /// A limit exceeded at this place.
    pub(super) fn limit(&self, what: &str, actual: u64, limit: u64, remedy: &str) -> SceneError {
        SceneError::Limit { place: self.place(), what: what.into(), actual, limit, remedy: remedy.into() }
    }
    fn mismatch(&self, wanted: &str) -> SceneError {
        let found = match self.value {
            Value::Null => "null".into(),
            Value::Bool(b) => b.to_string(),
            Value::Number(n) => n.to_string(),
            Value::String(s) => quoted(s),
            Value::Array(a) => format!("an array of {}", a.len()),
            Value::Object(_) => "an object".into(),
        };
        self.error(format!("expected {wanted}, found {found}"))
    }
    fn child(&self, key: &str, value: &'a Value) -> Item<'a> {
        let path = if self.path.is_empty() { key.into() } else { format!("{}.{key}", self.path) };
        Item { file: self.file, path, value }
    }
    /// The member `key`, where there is one. This value must be an object.
    pub(super) fn get(&self, key: &str) -> Result<Option<Item<'a>>> {
        match self.value {
            Value::Object(map) => Ok(map.get(key).map(|value| self.child(key, value))),
            _ => Err(self.mismatch("an object")),
        }
    }
    /// The member `key`.
    pub(super) fn require(&self, key: &str) -> Result<Item<'a>> {
        self.get(key)?.ok_or_else(|| self.error(format!("{key:?} is missing")))
    }
    /// The member `key` read by `read`, where there is one.
    pub(super) fn opt<T>(&self, key: &str, read: impl FnOnce(&Item<'a>) -> Result<T>) -> Result<Option<T>> {
        self.get(key)?.as_ref().map(read).transpose()
    }
    /// The member `key` of the extension `name`'s object, or that object itself for an empty key.
    pub(super) fn extension(&self, name: &str) -> Result<Option<Item<'a>>> {
        self.get("extensions")?.map_or(Ok(None), |e| e.get(name))
    }
    /// The elements of an array.
    pub(super) fn elements(&self) -> Result<Vec<Item<'a>>> {
        let values = self.values()?;
        Ok((0..values.len()).filter_map(|i| self.at(i)).collect())
    }
    /// The elements of an array without their places.
    pub(super) fn values(&self) -> Result<&'a [Value]> {
        self.value.as_array().map(Vec::as_slice).ok_or_else(|| self.mismatch("an array"))
    }
    /// Element `index` of an array.
    pub(super) fn at(&self, index: usize) -> Option<Item<'a>> {
        let value = self.value.as_array()?.get(index)?;
        Some(Item { file: self.file, path: format!("{}[{index}]", self.path), value })
    }
    /// A finite number.
    pub(super) fn number(&self) -> Result<f64> {
        self.value.as_f64().filter(|v| v.is_finite()).ok_or_else(|| self.mismatch("a number"))
    }
    /// A number that single precision can hold.
    pub(super) fn float(&self) -> Result<f32> {
        let v = self.number()? as f32;
        if v.is_finite() { Ok(v) } else { Err(self.mismatch("a number within single precision")) }
    }
    /// A whole number ≥ 0; `3.0` counts as 3.
    pub(super) fn unsigned(&self) -> Result<u64> {
        const EXACT: f64 = 9_007_199_254_740_992.0; // 2⁵³
        let whole = || self.value.as_f64().filter(|v| v.fract() == 0.0 && (0.0..=EXACT).contains(v)).map(|v| v as u64);
        self.value.as_u64().or_else(whole).ok_or_else(|| self.mismatch("a whole number ≥ 0"))
    }
    /// [`Item::unsigned`] as an index or size in memory.
    pub(super) fn size(&self) -> Result<usize> {
        usize::try_from(self.unsigned()?).map_err(|_| self.mismatch("a size this machine can address"))
    }
    /// A string.
    pub(super) fn text(&self) -> Result<&'a str> {
        self.value.as_str().ok_or_else(|| self.mismatch("a string"))
    }
    /// A truth value.
    pub(super) fn flag(&self) -> Result<bool> {
        self.value.as_bool().ok_or_else(|| self.mismatch("true or false"))
    }
    /// `N` finite numbers.
    pub(super) fn numbers<const N: usize>(&self) -> Result<[f64; N]> {
        let values = self.values()?;
        if values.len() != N {
            return Err(self.mismatch(&format!("an array of {N} numbers")));
        }
        let mut out = [0.0; N];
        for (slot, i) in out.iter_mut().zip(0..N) {
            *slot = self.at(i).ok_or_else(|| self.mismatch("a number"))?.number()?;
        }
        Ok(out)
    }
    /// `N` numbers that single precision can hold.
    pub(super) fn floats<const N: usize>(&self) -> Result<[f32; N]> {
        let wide = self.numbers::<N>()?;
        let narrow = wide.map(|v| v as f32);
        if narrow.iter().all(|v| v.is_finite()) {
            Ok(narrow)
        } else {
            Err(self.mismatch("numbers within single precision"))
        }
    }
}
