//! The wire of the Gatherlight cluster.
//!
//! - [`wire`]: messages and services generated from `proto/gatherlight.proto`;
//! - [`convert`]: the only place that turns wire into domain (`TryFrom`) and back (`From`);
//! - [`payload`]: photon batches, maps and tiles as bytes;
//! - [`chunk`]: bytes as a stream of bounded chunks, checked on arrival;
//! - [`pieces`]: payloads in pieces that are checked one by one, for the broadcast;
//! - [`serve`]: what servers of ours let their peers cost;
//! - [`stored`]: what the coordinator keeps of jobs in its store;
//! - [`connect`], [`credentials`]: how workers and clients reach a coordinator and prove who they are;
//! - [`collective`]: what collective operations moved;
//! - [`limits`]: what a peer may send at most.
#![deny(unsafe_code)]

pub mod chunk;
pub mod collective;
pub mod connect;
pub mod convert;
pub mod credentials;
pub mod digest;
pub mod error;
pub mod limits;
pub mod message;
pub mod payload;
pub mod pieces;
pub mod serve;
pub mod stored;
pub mod types;
pub mod version;

pub use digest::Digest;
pub use error::WireError;

/// Generated code.
#[allow(missing_docs, unreachable_pub, unused_qualifications, clippy::all)]
pub mod wire {
    tonic::include_proto!("gatherlight.v1");
}
