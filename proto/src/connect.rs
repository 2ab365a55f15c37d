//! How both workers and clients connect.

use crate::credentials::Credentials;
use crate::limits::{AUTHORIZATION_KEY, BROADCAST_WINDOW_BYTES, CONNECTION_WINDOW_BYTES};
use crate::version::Versions;
use std::time::Duration;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::transport::Endpoint;
use tonic::{Request, Status};

/// Time one attempt to connect may take.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Silence on a connection after which it is probed, and after which an unanswered probe ends it.
const KEEPALIVE: Duration = Duration::from_secs(10);
/// First pause between attempts.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
/// Longest pause between attempts.
const MAX_PAUSE: Duration = Duration::from_secs(10);

/// Where a coordinator is and how to reach it: `http://HOST:PORT`, or `https://HOST:PORT` with an authority to trust.
///
/// # Errors
/// What is wrong with the URL or the certificates.
pub fn endpoint(url: &str, credentials: &Credentials) -> Result<Endpoint, String> {
    let endpoint = Endpoint::from_shared(url.to_owned()).map_err(|e| e.to_string())?;
    let encrypted = match endpoint.uri().scheme_str() {
        Some("http") => false,
        Some("https") => true,
        Some(other) => return Err(format!("the scheme {other:?} is not supported")),
        None => return Err("it has no scheme".into()),
    };
    if endpoint.uri().host().is_none_or(str::is_empty) {
        return Err("it has no host".into());
    }
    let endpoint = match (encrypted, credentials.tls()) {
        (false, None) => endpoint,
        (true, Some(tls)) => {
            endpoint.tls_config(tls.clone()).map_err(|e| format!("its certificates: {}", reason(&e)))?
        }
        (true, None) => return Err("https asks for --tls-ca, the certificates of the authorities to trust".into()),
        (false, Some(_)) => return Err("--tls-ca asks for an https:// URL".into()),
    };
    Ok(tuned(endpoint))
}

/// An endpoint with this project's windows and timeouts.
pub fn tuned(endpoint: Endpoint) -> Endpoint {
    endpoint
        .connect_timeout(CONNECT_TIMEOUT)
        .initial_stream_window_size(BROADCAST_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .http2_keep_alive_interval(KEEPALIVE)
        .keep_alive_timeout(KEEPALIVE)
        .keep_alive_while_idle(true)
        .tcp_nodelay(true)
}

/// Puts the sender's versions and token on every call.
#[derive(Clone, Debug)]
pub struct Stamp {
    versions: Versions,
    authorization: Option<MetadataValue<Ascii>>,
}

impl Stamp {
    /// Of a peer that runs `versions` and proves itself by `credentials`.
    pub fn new(versions: Versions, credentials: &Credentials) -> Self {
        Stamp { versions, authorization: credentials.authorization() }
    }
}

impl Interceptor for Stamp {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        self.versions.write(request.metadata_mut());
        if let Some(authorization) = &self.authorization {
            request.metadata_mut().insert(AUTHORIZATION_KEY, authorization.clone());
        }
        Ok(request)
    }
}

/// Pause after failed attempt number `attempt` (from 0): doubling up to 10 s, with up to half of it taken off by
/// `random`, so that many do not come back at once.
pub fn pause(attempt: u32, random: u64) -> Duration {
    let full = FIRST_PAUSE.saturating_mul(1 << attempt.min(16)).min(MAX_PAUSE);
    full - full.mul_f64((random >> 11) as f64 / (1u64 << 53) as f64 / 2.0)
}

/// The innermost cause of a transport error: the outer ones say only "transport error".
pub fn reason(error: &dyn std::error::Error) -> String {
    let mut innermost = error;
    while let Some(source) = innermost.source() {
        innermost = source;
    }
    innermost.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_http_urls_with_a_host_are_taken() {
        let none = Credentials::default();
        assert!(endpoint("http://localhost:7420", &none).is_ok());
        for bad in ["localhost:7420", "ftp://x:1", "http://", "", "http://a b"] {
            assert!(endpoint(bad, &none).is_err(), "{bad:?}");
        }
        assert!(endpoint("https://x:1", &none).expect_err("is refused").contains("--tls-ca"));
    }

    #[test]
    fn pauses_double_up_to_a_bound_and_jitter_by_half() {
        assert_eq!(pause(0, 0), FIRST_PAUSE);
        assert_eq!(pause(3, 0), FIRST_PAUSE * 8);
        assert_eq!(pause(u32::MAX, 0), MAX_PAUSE);
        assert!(pause(u32::MAX, u64::MAX) >= MAX_PAUSE / 2 && pause(u32::MAX, u64::MAX) < MAX_PAUSE);
    }
}
