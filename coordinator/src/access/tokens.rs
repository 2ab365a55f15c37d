//! The coordinator's token file.
//!
//! ```text
//! # NAME  ROLES           TOKEN
//! farm    worker          6Jq…
//! alice   client          Zk2…
//! ops     worker,admin    b0T…
//! ```
//! A line that is a token alone belongs to `default` and allows everything. `gatherlight token` draws a line.

use super::Identity;
use gatherlight_proto::credentials::{Token, token_lines};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Most tokens of one file.
const MAX_TOKENS: usize = 10_000;
/// Longest name, in bytes.
const MAX_NAME_BYTES: usize = 64;
/// Name of a token that stands alone.
const DEFAULT_NAME: &str = "default";

/// What a token allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Join and compute.
    Worker,
    /// Submit jobs, and see and cancel one's own.
    Client,
    /// As [`Role::Client`], for everyone's jobs.
    Admin,
}

impl Role {
    /// All of them.
    pub const ALL: [Role; 3] = [Role::Worker, Role::Client, Role::Admin];
    /// As the file writes it.
    pub const fn name(self) -> &'static str {
        match self {
            Role::Worker => "worker",
            Role::Client => "client",
            Role::Admin => "admin",
        }
    }
    /// Roles by their names, with commas between them.
    ///
    /// # Errors
    /// When a name is none; it is not repeated, since it may be a token in the wrong place.
    pub fn parse_list(text: &str) -> Result<Vec<Role>, String> {
        let role = |name: &str| Role::ALL.into_iter().find(|r| r.name() == name);
        let roles = text.split(',').map(role).collect::<Option<Vec<_>>>();
        roles.ok_or_else(|| "roles are worker, client and admin, with commas between them".into())
    }
}

#[derive(Clone, Debug)]
struct Entry {
    identity: Identity,
    /// Of the token, which is not kept. Its `==` takes the same time wherever two digests differ.
    digest: blake3::Hash,
}

/// The tokens that a coordinator knows.
#[derive(Clone, Debug)]
pub struct Tokens(Vec<Entry>);

impl Tokens {
    /// Reads a token file.
    ///
    /// # Errors
    /// Line and fault, never what the line says.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut entries: Vec<Entry> = Vec::new();
        let mut names = BTreeSet::new();
        for (number, line) in token_lines(text) {
            let entry = entry(line).map_err(|e| format!("line {number}: {e}"))?;
            if !names.insert(entry.identity.name.clone()) {
                return Err(format!("line {number}: the name is there already, and jobs belong to names"));
            }
            if entries.iter().any(|e| e.digest == entry.digest) {
                return Err(format!("line {number}: the token is there already, so it tells nobody apart"));
            }
            if entries.len() == MAX_TOKENS {
                return Err(format!("line {number}: more than {MAX_TOKENS} tokens (MAX_TOKENS)"));
            }
            entries.push(entry);
        }
        if entries.is_empty() {
            return Err("it holds no token; `gatherlight token` draws one".into());
        }
        Ok(Tokens(entries))
    }
    /// Whose token this is. Takes the same time for any `presented` of the same length.
    pub(crate) fn find(&self, presented: &[u8]) -> Option<Identity> {
        let digest = blake3::hash(presented);
        // Every entry is compared, so that the time does not tell which one matched.
        let matching = self.0.iter().fold(None, |found, e| if e.digest == digest { Some(e) } else { found });
        matching.map(|e| e.identity.clone())
    }
}

fn entry(line: &str) -> Result<Entry, String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let (name, roles, token) = match words[..] {
        [token] => (DEFAULT_NAME, vec![Role::Worker, Role::Admin], token),
        [name, roles, token] => (name, Role::parse_list(roles)?, token),
        _ => return Err("has to be TOKEN or NAME ROLES TOKEN".into()),
    };
    check_name(name)?;
    let token = Token::new(token)?;
    let identity = Identity { name: Arc::from(name), roles };
    Ok(Entry { identity, digest: blake3::hash(token.reveal().as_bytes()) })
}

/// Checks the name of a token.
///
/// # Errors
/// What a name is made of.
pub(crate) fn check_name(name: &str) -> Result<(), String> {
    let fits = (1..=MAX_NAME_BYTES).contains(&name.len());
    if fits && name.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_.@".contains(&b)) {
        return Ok(());
    }
    Err(format!("a name has 1 … {MAX_NAME_BYTES} letters, digits, '-', '_', '.' and '@'"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "\
# who may do what
farm  worker        farm-SECRET-0123456789
alice client        alice-SECRET-0123456789

ops   worker,admin  ops-SECRET-0123456789
";

    #[test]
    fn tokens_are_found_with_their_names_and_roles() {
        let tokens = Tokens::parse(FILE).expect("is a token file");
        let roles = |token: &str| tokens.find(token.as_bytes()).map(|i| (i.name.to_string(), i.roles));
        assert_eq!(roles("farm-SECRET-0123456789"), Some(("farm".into(), vec![Role::Worker])));
        assert_eq!(roles("alice-SECRET-0123456789"), Some(("alice".into(), vec![Role::Client])));
        assert_eq!(roles("ops-SECRET-0123456789"), Some(("ops".into(), vec![Role::Worker, Role::Admin])));
        for wrong in ["", "alice", "alice-SECRET-012345678", "alice-SECRET-01234567890", "ALICE-SECRET-0123456789"] {
            assert_eq!(roles(wrong), None, "{wrong:?}");
        }
        let alone = Tokens::parse("just-a-SECRET-0123456789").expect("is a token file");
        let identity = alone.find(b"just-a-SECRET-0123456789").expect("is known");
        assert!(identity.may(Role::Worker) && identity.may(Role::Admin) && &*identity.name == "default");
    }

    #[test]
    fn senseless_files_are_refused_by_line_without_repeating_them() {
        for (bad, part) in [
            ("", "no token"),
            ("# only a comment\n", "no token"),
            ("short-SECRET", "line 1"),
            ("alice client", "line 1"),
            ("alice king SECRET-0123456789", "roles are"),
            ("alice client SECRET-0123456789 more", "NAME ROLES TOKEN"),
            ("a/b client SECRET-0123456789", "a name has"),
            ("a client SECRET-0123456789\na client SECRET-0123456780\n", "line 2: the name"),
            ("a client SECRET-0123456789\nb client SECRET-0123456789\n", "line 2: the token"),
        ] {
            let error = Tokens::parse(bad).expect_err("is refused");
            assert!(error.contains(part) && !error.contains("SECRET"), "{bad:?}: {error}");
        }
    }

    #[test]
    fn debug_shows_no_token() {
        let text = format!("{:?}", Tokens::parse(FILE));
        assert!(text.contains("alice") && !text.contains("SECRET"), "{text}");
    }
}
