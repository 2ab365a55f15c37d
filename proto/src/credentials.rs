//! What a worker or client proves itself by: a token, a certificate, or both; and whom it trusts.

use std::fmt;
use std::path::{Path, PathBuf};
use tonic::metadata::{Ascii, MetadataValue};
use tonic::transport::{Certificate, ClientTlsConfig, Identity, Uri};

/// Fewest characters of a token: 16 of them, drawn at random, cannot be tried out over a network.
pub const MIN_TOKEN_BYTES: usize = 16;
/// Longest token.
pub const MAX_TOKEN_BYTES: usize = 256;

/// A shared secret. Never shown: not by `Debug`, and no error repeats it.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

impl Token {
    /// Checks that `text` can be one.
    ///
    /// # Errors
    /// What is wrong with it, without repeating it.
    pub fn new(text: &str) -> Result<Self, String> {
        if !(MIN_TOKEN_BYTES..=MAX_TOKEN_BYTES).contains(&text.len()) {
            let found = text.len();
            return Err(format!(
                "the token has {found} characters; a token has {MIN_TOKEN_BYTES} … {MAX_TOKEN_BYTES}; \
                 `gatherlight token` draws one"
            ));
        }
        if !text.bytes().all(|b| b.is_ascii_graphic()) {
            return Err("a token is made of visible ASCII characters".into());
        }
        Ok(Token(text.to_owned()))
    }
    /// The only token in the text of a file: alone on its line, or the last word of the coordinator's line.
    /// Empty lines and lines that begin with `#` do not count.
    ///
    /// # Errors
    /// When there is none, or more than one.
    pub fn only_one(text: &str) -> Result<Self, String> {
        let mut lines = token_lines(text);
        let (Some((_, line)), None) = (lines.next(), lines.next()) else {
            return Err("has to hold exactly one token; the coordinator's file may hold several, one a line".into());
        };
        Token::new(line.split_whitespace().next_back().unwrap_or_default())
    }
    /// Its characters, for comparing and sending only.
    pub fn reveal(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

/// Lines of a token file that hold one, with their numbers from 1.
pub fn token_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = text.lines().map(str::trim).enumerate().map(|(i, line)| (i + 1, line));
    lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// Where the parts of [`Credentials`] are.
#[derive(Clone, Debug, Default)]
pub struct CredentialFiles {
    /// A token.
    pub token: Option<PathBuf>,
    /// Certificates (PEM) of the authorities trusted to vouch for the coordinator; asks for an `https://` URL.
    pub authority: Option<PathBuf>,
    /// Own certificate (PEM); asks for `key`.
    pub certificate: Option<PathBuf>,
    /// Its key (PEM).
    pub key: Option<PathBuf>,
}

/// See the module. Without any, a peer proves nothing, over an unencrypted connection.
#[derive(Clone, Default)]
pub struct Credentials {
    token: Option<Token>,
    tls: Option<ClientTlsConfig>,
}

impl fmt::Debug for Credentials {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Credentials").field("token", &self.token).field("tls", &self.tls.is_some()).finish()
    }
}

impl Credentials {
    /// Only a token.
    pub fn of_token(token: Token) -> Self {
        Credentials { token: Some(token), tls: None }
    }
    /// Reads the files.
    ///
    /// # Errors
    /// Which file is missing or wrong, and how; never what is in it.
    pub fn read(files: &CredentialFiles) -> Result<Self, String> {
        let token = match &files.token {
            Some(path) => Some(Token::only_one(&read(path)?).map_err(|e| format!("{}: {e}", path.display()))?),
            None => None,
        };
        let tls = match &files.authority {
            Some(authority) => {
                let config = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(read(authority)?));
                Some(match identity(files.certificate.as_deref(), files.key.as_deref())? {
                    Some(identity) => config.identity(identity),
                    None => config,
                })
            }
            None if files.certificate.is_some() || files.key.is_some() => {
                return Err(
                    "--tls-cert and --tls-key ask for --tls-ca, the authority that vouches for the coordinator".into(),
                );
            }
            None => None,
        };
        Ok(Credentials { token, tls })
    }
    /// How to encrypt, where an authority was given.
    pub fn tls(&self) -> Option<&ClientTlsConfig> {
        self.tls.as_ref()
    }
    /// The header that carries the token.
    pub(crate) fn authorization(&self) -> Option<MetadataValue<Ascii>> {
        let token = self.token.as_ref()?;
        let mut value = MetadataValue::try_from(format!("Bearer {}", token.reveal())).ok()?;
        value.set_sensitive(true);
        Some(value)
    }
    /// What is risky about using them with `url`, if anything is.
    pub fn warning(&self, url: &str) -> Option<String> {
        self.token.as_ref()?;
        let uri: Uri = url.parse().ok()?;
        let host = uri.host()?;
        (uri.scheme_str() == Some("http") && !is_loopback(host)).then(|| {
            format!("the token travels to {host} unencrypted: whoever listens on the way can use it; see docs/security.md for TLS")
        })
    }
}

/// Whether `host` of a URL is this machine.
fn is_loopback(host: &str) -> bool {
    let address = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || address.parse::<std::net::IpAddr>().is_ok_and(|a| a.is_loopback())
}

/// A certificate and its key; neither or both.
///
/// # Errors
/// When only one is given, or a file cannot be read.
pub fn identity(certificate: Option<&Path>, key: Option<&Path>) -> Result<Option<Identity>, String> {
    match (certificate, key) {
        (Some(certificate), Some(key)) => Ok(Some(Identity::from_pem(read(certificate)?, read(key)?))),
        (None, None) => Ok(None),
        _ => Err("--tls-cert and --tls-key belong together".into()),
    }
}

/// A text file.
///
/// # Errors
/// Its path and the system's reason.
pub fn read(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(|e| format!("cannot read {}: {e}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECRET: &str = "0123456789abcdef-SECRET";

    #[test]
    fn tokens_are_checked_and_never_shown() {
        let token = Token::new(SECRET).expect("is one");
        let credentials = Credentials::of_token(token.clone());
        for text in [format!("{token:?}"), format!("{credentials:?}"), format!("{:?}", credentials.authorization())] {
            assert!(!text.contains("SECRET"), "{text}");
        }
        for bad in ["short-SECRET", &"SECRET ".repeat(5), &"SECRET".repeat(100), "SECRET-ünicode-SECRET"] {
            assert!(!Token::new(bad).expect_err("is none").contains("SECRET"));
        }
    }

    #[test]
    fn a_file_of_one_token_may_have_comments_and_the_coordinator_s_form() {
        let bare = Token::only_one(&format!("# mine\n\n  {SECRET}\n"));
        assert_eq!(bare, Token::new(SECRET));
        assert_eq!(Token::only_one(&format!("alice client {SECRET}")), bare);
        for bad in ["", "# nothing\n", &format!("{SECRET}\n{SECRET}\n")] {
            assert!(Token::only_one(bad).is_err_and(|e| !e.contains("SECRET")), "{bad:?}");
        }
    }

    #[test]
    fn a_token_sent_in_the_clear_is_warned_of() {
        let with = Credentials::of_token(Token::new(SECRET).expect("is one"));
        for quiet in ["http://localhost:7420", "http://127.0.0.1:1", "http://[::1]:1", "https://farm.example:7420"] {
            assert_eq!(with.warning(quiet), None);
        }
        assert!(with.warning("http://farm.example:7420").is_some_and(|w| w.contains("farm.example")));
        assert_eq!(Credentials::default().warning("http://farm.example:7420"), None);
    }

    #[test]
    fn halves_of_a_certificate_are_refused() {
        let files = CredentialFiles { certificate: Some("x".into()), ..CredentialFiles::default() };
        assert!(Credentials::read(&files).expect_err("is refused").contains("--tls-ca"));
        assert!(identity(Some(Path::new("x")), None).expect_err("is refused").contains("belong together"));
    }
}
