//! Messages of the broadcast's relay.

use crate::digest::Digest;
use crate::error::WireError;
use crate::limits::{MAX_MAP_BYTES, MAX_SOURCES};
use crate::message::{BlobRef, PassRequest, PassTicket, RelayAddress, Route};
use crate::pieces::STRIPES;
use crate::wire;
use bytes::Bytes;
use std::net::SocketAddr;

/// Longest address: IPv6 with scope and port.
const MAX_ADDRESS_BYTES: u64 = 128;

fn address(text: &str) -> Result<SocketAddr, WireError> {
    WireError::check_limit("address length in bytes", text.len() as u64, MAX_ADDRESS_BYTES, "MAX_ADDRESS_BYTES")?;
    text.parse().map_err(|_| WireError::invalid("address", format!("{text:?} is no IP address with a port")))
}

fn ticket(bytes: &[u8]) -> Result<PassTicket, WireError> {
    bytes.try_into().map(PassTicket).map_err(|_| WireError::invalid("ticket", "has to have 16 bytes"))
}

fn ticket_bytes(ticket: PassTicket) -> Bytes {
    Bytes::copy_from_slice(&ticket.0)
}

impl From<RelayAddress> for wire::RelayAddress {
    fn from(r: RelayAddress) -> Self {
        wire::RelayAddress { address: r.address.to_string(), given: r.given }
    }
}

impl TryFrom<wire::RelayAddress> for RelayAddress {
    type Error = WireError;
    fn try_from(r: wire::RelayAddress) -> Result<Self, WireError> {
        Ok(RelayAddress { address: address(&r.address)?, given: r.given })
    }
}

impl From<Route> for wire::Route {
    fn from(r: Route) -> Self {
        let sources = |s: &Vec<SocketAddr>| wire::Sources { addresses: s.iter().map(SocketAddr::to_string).collect() };
        wire::Route {
            digest: r.blob.digest.to_bytes(),
            bytes: r.blob.bytes,
            ticket: ticket_bytes(r.ticket),
            stripes: r.sources.iter().map(sources).collect(),
        }
    }
}

impl TryFrom<wire::Route> for Route {
    type Error = WireError;
    fn try_from(r: wire::Route) -> Result<Self, WireError> {
        WireError::check_limit("payload size in bytes", r.bytes, MAX_MAP_BYTES, "MAX_MAP_BYTES")?;
        let mut sources: [Vec<SocketAddr>; STRIPES] = Default::default();
        if r.stripes.len() != STRIPES {
            let message = format!("there are {} stripes, not {STRIPES}", r.stripes.len());
            return Err(WireError::invalid("stripes", message));
        }
        for (own, theirs) in sources.iter_mut().zip(r.stripes) {
            let count = theirs.addresses.len() as u64;
            WireError::check_limit("sources of a stripe", count, MAX_SOURCES as u64, "MAX_SOURCES")?;
            *own = theirs.addresses.iter().map(|a| address(a)).collect::<Result<_, _>>()?;
        }
        let blob = BlobRef { digest: Digest::try_from(&r.digest[..])?, bytes: r.bytes };
        Ok(Route { blob, ticket: ticket(&r.ticket)?, sources })
    }
}

impl From<PassRequest> for wire::PassRequest {
    fn from(r: PassRequest) -> Self {
        let PassRequest { digest, ticket, stripe, first } = r;
        wire::PassRequest { digest: digest.to_bytes(), ticket: ticket_bytes(ticket), stripe: stripe as u32, first }
    }
}

impl TryFrom<wire::PassRequest> for PassRequest {
    type Error = WireError;
    fn try_from(r: wire::PassRequest) -> Result<Self, WireError> {
        let (stripe, first) = (r.stripe as usize, r.first);
        if stripe >= STRIPES || first % STRIPES as u64 != stripe as u64 {
            return Err(WireError::invalid("stripe", format!("piece {first} is in no stripe {stripe}")));
        }
        Ok(PassRequest { digest: Digest::try_from(&r.digest[..])?, ticket: ticket(&r.ticket)?, stripe, first })
    }
}
