//! Who may speak to a coordinator, and what they may do.
//!
//! Peers prove themselves by a token, by a certificate, or by being on this machine where nothing else is asked for. What
//! a client submits is its own: jobs belong to the name of the token (or to the certificate) that submitted them.

mod tokens;

pub use tokens::{Role, Tokens};

pub(crate) use tokens::check_name as check_token_name;

use gatherlight_proto::Digest;
use gatherlight_proto::credentials::{identity, read};
use gatherlight_proto::limits::AUTHORIZATION_KEY;
use gatherlight_proto::serve::Peer;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use tonic::transport::server::TlsConnectInfo;
use tonic::transport::{Certificate, ServerTlsConfig};
use tonic::{Request, Status};

/// Digits of a certificate's digest that name its owner.
const FINGERPRINT_DIGITS: usize = 32;

/// What peers have to prove.
#[derive(Clone, Debug, Default)]
pub struct AccessConfig {
    /// Tokens: who they belong to and what they allow, one a line.
    pub token_file: Option<PathBuf>,
    /// The coordinator's own certificate (PEM): connections are encrypted.
    pub tls_certificate: Option<PathBuf>,
    /// Its key (PEM).
    pub tls_key: Option<PathBuf>,
    /// Authority (PEM) that has to vouch for every peer's certificate.
    pub tls_client_ca: Option<PathBuf>,
    /// Listens on the network though peers prove nothing.
    pub insecure: bool,
}

impl AccessConfig {
    /// Reads the files and checks that `listen` may be opened with them.
    ///
    /// # Errors
    /// What is missing or wrong; never what is in a file.
    pub(crate) fn open(&self, listen: SocketAddr) -> Result<(Access, Option<ServerTlsConfig>), String> {
        let own = identity(self.tls_certificate.as_deref(), self.tls_key.as_deref())?;
        if self.tls_client_ca.is_some() && own.is_none() {
            return Err("--tls-client-ca asks for --tls-cert and --tls-key, the coordinator's own".into());
        }
        let access = match (&self.token_file, &self.tls_client_ca) {
            (Some(path), _) => {
                let tokens = Tokens::parse(&read(path)?).map_err(|e| format!("{}, {e}", path.display()))?;
                Access::Tokens(Arc::new(tokens))
            }
            (None, Some(_)) => Access::Certificates,
            (None, None) if self.insecure || listen.ip().is_loopback() => Access::Open,
            (None, None) => {
                return Err(format!(
                    "{listen} can be reached from other machines, and whoever reaches it could submit work: give \
                     --token-file, or --tls-client-ca with --tls-cert and --tls-key; or, where everyone who can connect \
                     is trusted, --insecure"
                ));
            }
        };
        let tls = match own {
            Some(own) => {
                let config = ServerTlsConfig::new().identity(own);
                Some(match &self.tls_client_ca {
                    Some(authority) => config.client_ca_root(Certificate::from_pem(read(authority)?)),
                    None => config,
                })
            }
            None => None,
        };
        if tls.is_none() && !listen.ip().is_loopback() {
            tracing::warn!(%listen, "connections are not encrypted; see docs/security.md for TLS");
        }
        Ok((access, tls))
    }
}

/// How peers are told apart.
#[derive(Clone, Debug)]
pub(crate) enum Access {
    /// Not at all: everyone may do everything.
    Open,
    /// By the token of each call.
    Tokens(Arc<Tokens>),
    /// By the certificate of their connection.
    Certificates,
}

/// Who makes a call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Identity {
    /// Owner of what it submits; empty where there are no tokens or certificates.
    pub(crate) name: Arc<str>,
    roles: Vec<Role>,
}

impl Identity {
    /// Whether it may do what `role` may.
    pub(crate) fn may(&self, role: Role) -> bool {
        self.roles.contains(&role) || (role == Role::Client && self.roles.contains(&Role::Admin))
    }
    /// Whether it may know of a job of `owner`.
    pub(crate) fn sees(&self, owner: &str) -> bool {
        self.may(Role::Admin) || *self.name == *owner
    }
}

impl Access {
    /// Who makes this call. Looks at its metadata and connection only, never at its body.
    ///
    /// # Errors
    /// `UNAUTHENTICATED`, without a hint of what would have been right.
    pub(crate) fn identify(&self, request: &Request<()>) -> Result<Identity, Status> {
        match self {
            Access::Open => Ok(Identity { name: "".into(), roles: vec![Role::Worker, Role::Admin] }),
            Access::Tokens(tokens) => {
                let header = request.metadata().get(AUTHORIZATION_KEY).map(|v| v.as_bytes());
                let presented = header
                    .and_then(|v| v.strip_prefix(b"Bearer "))
                    .ok_or_else(|| Status::unauthenticated("this coordinator asks for a token: give --token-file"))?;
                let known = tokens.find(presented);
                known.ok_or_else(|| Status::unauthenticated("the token is not one of this coordinator's"))
            }
            Access::Certificates => {
                let certificates = request.extensions().get::<TlsConnectInfo<Peer>>().and_then(|i| i.peer_certs());
                let own = certificates.as_ref().and_then(|c| c.first());
                let own = own.ok_or_else(|| Status::unauthenticated("this coordinator asks for a certificate"))?;
                let digest = Digest::of(own).to_string();
                let name = format!("certificate {}", &digest[..FINGERPRINT_DIGITS]);
                Ok(Identity { name: name.into(), roles: vec![Role::Worker, Role::Client] })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opened(listen: &str, config: &AccessConfig) -> Result<Access, String> {
        config.open(listen.parse().expect("an address")).map(|(access, _)| access)
    }

    #[test]
    fn only_this_machine_may_connect_without_proof() {
        let none = AccessConfig::default();
        for near in ["127.0.0.1:7420", "127.8.9.1:0", "[::1]:7420"] {
            assert!(matches!(opened(near, &none), Ok(Access::Open)), "{near}");
        }
        for far in ["0.0.0.0:7420", "[::]:7420", "192.0.2.1:7420"] {
            let refused = opened(far, &none).expect_err("is refused");
            for way in [far, "--token-file", "--tls-client-ca", "--insecure"] {
                assert!(refused.contains(way), "{refused}");
            }
            assert!(opened(far, &AccessConfig { insecure: true, ..none.clone() }).is_ok());
        }
    }

    #[test]
    fn an_own_certificate_alone_proves_nothing_of_peers() {
        let directory = tempfile::tempdir().expect("a directory");
        let pem = directory.path().join("x.pem");
        std::fs::write(&pem, "").expect("is written");
        let tls = AccessConfig { tls_certificate: Some(pem.clone()), tls_key: Some(pem.clone()), ..Default::default() };
        assert!(opened("0.0.0.0:1", &tls).expect_err("is refused").contains("--token-file"));
        let halves = AccessConfig { tls_certificate: Some(pem.clone()), ..Default::default() };
        assert!(opened("127.0.0.1:1", &halves).expect_err("is refused").contains("belong together"));
        let authority = AccessConfig { tls_client_ca: Some(pem), ..Default::default() };
        assert!(opened("127.0.0.1:1", &authority).expect_err("is refused").contains("--tls-cert"));
    }

    #[test]
    fn errors_in_a_token_file_name_it_and_not_what_is_in_it() {
        let directory = tempfile::tempdir().expect("a directory");
        let path = directory.path().join("tokens");
        std::fs::write(&path, "alice king SECRET-0123456789abcdef\n").expect("is written");
        let config = AccessConfig { token_file: Some(path.clone()), ..Default::default() };
        let text = opened("127.0.0.1:1", &config).expect_err("is refused");
        assert!(text.contains("tokens") && text.contains("line 1") && !text.contains("SECRET"), "{text}");
        let absent = AccessConfig { token_file: Some(directory.path().join("absent")), ..Default::default() };
        assert!(opened("127.0.0.1:1", &absent).expect_err("is refused").contains("absent"));
    }

    #[test]
    fn owners_see_their_own_jobs_and_admins_all() {
        let identity = |roles: &[Role]| Identity { name: "alice".into(), roles: roles.to_vec() };
        let client = identity(&[Role::Client]);
        assert!(client.sees("alice") && !client.sees("bob") && !client.sees(""));
        assert!(identity(&[Role::Admin]).sees("bob") && identity(&[Role::Admin]).may(Role::Client));
        assert!(!client.may(Role::Worker) && !identity(&[Role::Worker]).may(Role::Client));
        assert!(!identity(&[Role::Admin]).may(Role::Worker));
    }
}
