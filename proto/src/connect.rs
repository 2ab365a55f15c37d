//! How both workers and clients connect.

use crate::limits::{CONNECTION_WINDOW_BYTES, STREAM_WINDOW_BYTES};
use crate::version::Versions;
use std::time::Duration;
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

/// Checks a coordinator's URL.
///
/// # Errors
/// What is wrong with it.
pub fn endpoint(url: &str) -> Result<Endpoint, String> {
    let endpoint = Endpoint::from_shared(url.to_owned()).map_err(|e| e.to_string())?;
    match endpoint.uri().scheme_str() {
        Some("http") => {}
        Some(other) => return Err(format!("the scheme {other:?} is not supported")),
        None => return Err("it has no scheme".into()),
    }
    if endpoint.uri().host().is_none_or(str::is_empty) {
        return Err("it has no host".into());
    }
    Ok(tuned(endpoint))
}

/// An endpoint with this project's windows and timeouts.
pub fn tuned(endpoint: Endpoint) -> Endpoint {
    endpoint
        .connect_timeout(CONNECT_TIMEOUT)
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .http2_keep_alive_interval(KEEPALIVE)
        .keep_alive_timeout(KEEPALIVE)
        .keep_alive_while_idle(true)
        .tcp_nodelay(true)
}

/// Puts the sender's versions on every call.
#[derive(Clone, Debug)]
pub struct Stamp(pub Versions);

impl Interceptor for Stamp {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        self.0.write(request.metadata_mut());
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
        assert!(endpoint("http://localhost:7420").is_ok());
        for bad in ["localhost:7420", "ftp://x:1", "https://x:1", "http://", "", "http://a b"] {
            assert!(endpoint(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn pauses_double_up_to_a_bound_and_jitter_by_half() {
        assert_eq!(pause(0, 0), FIRST_PAUSE);
        assert_eq!(pause(3, 0), FIRST_PAUSE * 8);
        assert_eq!(pause(u32::MAX, 0), MAX_PAUSE);
        assert!(pause(u32::MAX, u64::MAX) >= MAX_PAUSE / 2 && pause(u32::MAX, u64::MAX) < MAX_PAUSE);
    }
}
