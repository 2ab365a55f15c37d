//! Calls that were refused, counted by reason.

use super::Tally;
use std::convert::Infallible;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use tonic::codegen::{Service, http};
use tonic::{Code, Status};

/// Counts the calls that the services within it refuse, by status.
#[derive(Clone, Debug)]
pub struct CountRefusals<S> {
    inner: S,
    tally: Arc<dyn Tally>,
}

impl<S> CountRefusals<S> {
    /// Around `inner`, counted by `tally`.
    pub fn new(inner: S, tally: Arc<dyn Tally>) -> Self {
        CountRefusals { inner, tally }
    }
}

type Counted<R> = Pin<Box<dyn Future<Output = Result<R, Infallible>> + Send>>;

impl<S, Q, B> Service<http::Request<Q>> for CountRefusals<S>
where
    S: Service<http::Request<Q>, Response = http::Response<B>, Error = Infallible>,
    S::Future: Send + 'static,
{
    type Response = http::Response<B>;
    type Error = Infallible;
    type Future = Counted<http::Response<B>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        self.inner.poll_ready(context)
    }
    fn call(&mut self, request: http::Request<Q>) -> Self::Future {
        let (answer, tally) = (self.inner.call(request), self.tally.clone());
        Box::pin(async move {
            let response = answer.await?;
            // Refused calls have no body: their status is among the headers.
            if let Some(status) = Status::from_header_map(response.headers())
                && let Some(reason) = reason(status.code())
            {
                tally.refused(reason);
            }
            Ok(response)
        })
    }
}

/// As metrics write it; none for an answer that is no refusal.
fn reason(code: Code) -> Option<&'static str> {
    Some(match code {
        Code::Ok => return None,
        Code::Unauthenticated => "unauthenticated",
        Code::PermissionDenied => "permission_denied",
        Code::NotFound => "not_found",
        Code::InvalidArgument | Code::OutOfRange => "invalid_argument",
        Code::FailedPrecondition => "failed_precondition",
        Code::ResourceExhausted => "resource_exhausted",
        Code::DataLoss => "data_loss",
        Code::DeadlineExceeded => "deadline_exceeded",
        Code::Unimplemented => "unimplemented",
        Code::Cancelled | Code::Unavailable => "unavailable",
        Code::Unknown | Code::Internal | Code::Aborted | Code::AlreadyExists => "internal",
    })
}
