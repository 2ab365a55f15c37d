//! What every call passes before any of its body is read: who makes it, whether it may, and the versions.

use super::connection::Peer;
use crate::access::{Access, Role};
use crate::counters::Counters;
use gatherlight_proto::version;
use std::convert::Infallible;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use tonic::codegen::{Service, http};
use tonic::service::Interceptor;
use tonic::{Code, Request, Status};

/// Before one of the services.
#[derive(Clone, Debug)]
pub(super) struct Gate {
    pub(super) access: Access,
    pub(super) role: Role,
}

impl Interceptor for Gate {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        let peer = Peer::of(request.extensions()).cloned();
        // Counted before anything is looked up, so that tokens cannot be tried out quickly either.
        if peer.as_ref().is_some_and(|p| !p.may_call()) {
            return Err(Status::resource_exhausted("too many calls a second on this connection; slow down"));
        }
        let identity = self.access.identify(&request)?;
        let (deed, same_program) = match self.role {
            Role::Worker => ("worker", true),
            Role::Client | Role::Admin => ("client", false),
        };
        if !identity.may(self.role) {
            let text =
                format!("this token is none of a {deed}: its roles in the coordinator's token file do not say so");
            return Err(Status::permission_denied(text));
        }
        version::check(request.metadata(), deed, same_program)?;
        if let Some(peer) = peer {
            peer.introduce();
        }
        request.extensions_mut().insert(identity);
        Ok(request)
    }
}

/// Counts the calls that were refused, by status. Around all services.
#[derive(Clone, Debug)]
pub(crate) struct CountRefusals<S> {
    pub(super) inner: S,
    pub(super) counters: Arc<Counters>,
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
        let (answer, counters) = (self.inner.call(request), self.counters.clone());
        Box::pin(async move {
            let response = answer.await?;
            // Refused calls have no body: their status is among the headers.
            if let Some(status) = Status::from_header_map(response.headers())
                && let Some(reason) = reason(status.code())
            {
                counters.refused(reason);
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
