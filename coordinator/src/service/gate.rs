//! What every call passes before any of its body is read: who makes it, whether it may, and the versions.

use crate::access::{Access, Role};
use gatherlight_proto::serve::Peer;
use gatherlight_proto::version;
use tonic::service::Interceptor;
use tonic::{Request, Status};

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
