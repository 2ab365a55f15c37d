//! Rust sources as the rules read them: comments and literals blanked out, test code marked, functions found.

use std::fs;
use std::path::{Path, PathBuf};

/// A source file of the workspace.
pub(crate) struct Source {
    /// Path from the workspace's root, with `/`.
    pub(crate) path: String,
    /// The code with comments and the contents of literals blanked out; the same lines and byte offsets as the file.
    pub(crate) code: String,
    /// Lines of the file.
    pub(crate) line_count: usize,
    test_code: Vec<(usize, usize)>,
}

/// A function: where it is and how long, from its `fn` to its closing brace.
pub(crate) struct Function {
    /// Name.
    pub(crate) name: String,
    /// Line of `fn`, from 1.
    pub(crate) line: usize,
    /// Lines.
    pub(crate) length: usize,
}

impl Source {
    /// Reads `text` as the file at `path`.
    pub(crate) fn new(path: &str, text: &str) -> Self {
        let code = blank_comments_and_literals(text);
        let whole = path.contains("/tests/")
            || path.starts_with("tests/")
            || path.contains("/benches/")
            || path.ends_with("/tests.rs")
            || path.ends_with("_tests.rs");
        let test_code = if whole { vec![(0, code.len())] } else { test_modules(&code) };
        Source { path: path.to_owned(), code, line_count: text.lines().count(), test_code }
    }

    /// Line of a byte offset, from 1.
    pub(crate) fn line_at(&self, offset: usize) -> usize {
        self.code.as_bytes()[..offset].iter().filter(|&&b| b == b'\n').count() + 1
    }

    /// Whether the code at `offset` is compiled for tests only.
    pub(crate) fn is_test(&self, offset: usize) -> bool {
        self.test_code.iter().any(|&(begin, end)| (begin..end).contains(&offset))
    }

    /// Offsets of `word` in the code, where no letter, digit or underscore continues it on either side.
    pub(crate) fn words<'a>(&'a self, word: &'a str) -> impl Iterator<Item = usize> + 'a {
        let bytes = self.code.as_bytes();
        let first_joins = word.bytes().next().is_some_and(is_word);
        let last_joins = word.bytes().last().is_some_and(is_word);
        self.code.match_indices(word).map(|(offset, _)| offset).filter(move |&offset| {
            let before = offset.checked_sub(1).is_some_and(|i| first_joins && is_word(bytes[i]));
            let after = bytes.get(offset + word.len()).is_some_and(|&b| last_joins && is_word(b));
            !before && !after
        })
    }

    /// Offsets of `word` outside test code.
    pub(crate) fn words_outside_tests<'a>(&'a self, word: &'a str) -> impl Iterator<Item = usize> + 'a {
        self.words(word).filter(|&offset| !self.is_test(offset))
    }

    /// The functions with a body.
    pub(crate) fn functions(&self) -> Vec<Function> {
        let bytes = self.code.as_bytes();
        self.words("fn")
            .filter_map(|offset| {
                let name: String =
                    self.code[offset + 2..].trim_start().chars().take_while(|&c| is_word_char(c)).collect();
                let open = body_start(bytes, offset)?;
                let close = matching_brace(bytes, open)?;
                let line = self.line_at(offset);
                (!name.is_empty()).then(|| Function { name, line, length: self.line_at(close) - line + 1 })
            })
            .collect()
    }
}

/// The workspace's root.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Reads a text file of the workspace.
pub(crate) fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|e| panic!("{path}: {e}"))
}

/// Every Rust source file of the packages, in order of path.
pub(crate) fn workspace_sources() -> Vec<Source> {
    let mut paths = Vec::new();
    for package in ["coordinator", "proto", "render", "telemetry", "tests", "worker"] {
        collect(&root().join(package), package, &mut paths);
    }
    paths.sort();
    assert!(paths.len() > 20, "the workspace's sources were not found: {paths:?}");
    paths.iter().map(|path| Source::new(path, &read(path))).collect()
}

fn collect(directory: &Path, prefix: &str, paths: &mut Vec<String>) {
    for entry in fs::read_dir(directory).unwrap_or_else(|e| panic!("{}: {e}", directory.display())).flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = format!("{prefix}/{name}");
        if entry.path().is_dir() {
            if name != "target" {
                collect(&entry.path(), &path, paths);
            }
        } else if name.ends_with(".rs") {
            paths.push(path);
        }
    }
}

fn is_word(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'_'
}

/// Whether `c` may stand in an identifier.
pub(crate) fn is_word_char(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// The `{` that opens the body of the item whose keyword is at `offset`; none for a declaration that ends with `;`.
fn body_start(bytes: &[u8], offset: usize) -> Option<usize> {
    let mut depth = 0_i32;
    for (i, &b) in bytes.iter().enumerate().skip(offset) {
        match b {
            b'(' | b'[' => depth += 1,
            b')' | b']' => depth -= 1,
            b'{' if depth == 0 => return Some(i),
            b';' if depth == 0 => return None,
            _ => {}
        }
        if depth < 0 {
            return None; // `fn` in a type, inside somebody's parentheses
        }
    }
    None
}

fn matching_brace(bytes: &[u8], open: usize) -> Option<usize> {
    let mut depth = 0_usize;
    for (i, &b) in bytes.iter().enumerate().skip(open) {
        match b {
            b'{' => depth += 1,
            b'}' => {
                depth -= 1;
                if depth == 0 {
                    return Some(i);
                }
            }
            _ => {}
        }
    }
    None
}

/// Byte ranges of the items under `#[cfg(test)]` or `#[test]`.
fn test_modules(code: &str) -> Vec<(usize, usize)> {
    let bytes = code.as_bytes();
    ["#[cfg(test)]", "#[test]"]
        .iter()
        .flat_map(|attribute| code.match_indices(attribute))
        .map(|(offset, attribute)| {
            let item = offset + attribute.len();
            let end = body_start(bytes, item).and_then(|open| matching_brace(bytes, open));
            let end = end.or_else(|| code[item..].find(';').map(|i| item + i));
            (offset, end.map_or(code.len(), |i| i + 1))
        })
        .collect()
}

/// Replaces comments and the contents of string and character literals by spaces; newlines stay.
fn blank_comments_and_literals(text: &str) -> String {
    let bytes = text.as_bytes();
    let mut code = bytes.to_vec();
    let mut i = 0;
    while i < bytes.len() {
        let end = match bytes[i] {
            b'/' if bytes[i..].starts_with(b"//") => {
                i + bytes[i..].iter().position(|&b| b == b'\n').unwrap_or(bytes.len() - i)
            }
            b'/' if bytes[i..].starts_with(b"/*") => block_comment_end(bytes, i),
            b'"' => string_end(bytes, i),
            b'r' | b'b' if i == 0 || !is_word(bytes[i - 1]) => raw_string_end(bytes, i).unwrap_or(i),
            b'\'' => char_end(bytes, i).unwrap_or(i),
            _ => i,
        };
        code[i..end].iter_mut().filter(|b| **b != b'\n').for_each(|b| *b = b' ');
        i = end.max(i + 1);
    }
    // Only whole characters were replaced, byte by byte: what is left is still UTF-8.
    String::from_utf8(code).unwrap_or_default()
}

fn block_comment_end(bytes: &[u8], begin: usize) -> usize {
    let mut depth = 0_usize;
    let mut i = begin;
    while i < bytes.len() {
        if bytes[i..].starts_with(b"/*") {
            depth += 1;
            i += 2;
        } else if bytes[i..].starts_with(b"*/") {
            depth -= 1;
            i += 2;
            if depth == 0 {
                return i;
            }
        } else {
            i += 1;
        }
    }
    bytes.len()
}

fn string_end(bytes: &[u8], begin: usize) -> usize {
    let mut i = begin + 1;
    while i < bytes.len() {
        match bytes[i] {
            b'\\' => i += 2,
            b'"' => return i + 1,
            _ => i += 1,
        }
    }
    bytes.len()
}

/// End of `r"…"`, `r#"…"#`, `br"…"`; none where the letter starts something else.
fn raw_string_end(bytes: &[u8], begin: usize) -> Option<usize> {
    let after_b = begin + usize::from(bytes[begin] == b'b');
    if bytes.get(after_b) != Some(&b'r') {
        return None;
    }
    let hashes = bytes[after_b + 1..].iter().take_while(|&&b| b == b'#').count();
    let quote = after_b + 1 + hashes;
    if bytes.get(quote) != Some(&b'"') {
        return None;
    }
    let mut closing = vec![b'"'];
    closing.resize(1 + hashes, b'#');
    let length = bytes[quote + 1..].windows(closing.len()).position(|w| w == closing)?;
    Some(quote + 1 + length + closing.len())
}

/// End of a character literal; none for a lifetime.
fn char_end(bytes: &[u8], begin: usize) -> Option<usize> {
    match bytes.get(begin + 1)? {
        b'\\' => bytes[begin + 3..].iter().position(|&b| b == b'\'').map(|i| begin + 3 + i + 1),
        first => {
            let width = match first {
                0x00..=0x7f => 1,
                0xc0..=0xdf => 2,
                0xe0..=0xef => 3,
                _ => 4,
            };
            (bytes.get(begin + 1 + width) == Some(&b'\'')).then_some(begin + 2 + width)
        }
    }
}
