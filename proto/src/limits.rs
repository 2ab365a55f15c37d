//! Limits of the wire. A peer that exceeds one is refused with an error that names it.

use std::time::Duration;

/// Version of messages and payload layouts; both sides must have the same.
pub const PROTOCOL_VERSION: u32 = 8;
/// Metadata key of the sender's [`PROTOCOL_VERSION`].
pub const PROTOCOL_KEY: &str = "gatherlight-protocol";
/// Metadata key of the sender's program version.
pub const VERSION_KEY: &str = "gatherlight-version";

/// Metadata key of the sender's token: `Bearer TOKEN`.
pub const AUTHORIZATION_KEY: &str = "authorization";

/// Payload bytes in one chunk: well under gRPC's default message limit of 4 MiB, large enough that the cost per
/// message does not show.
pub const CHUNK_BYTES: usize = 2 << 20;
/// Smallest piece of a broadcast: what arrives is passed on after so many bytes, and each costs a message.
pub const MIN_PIECE_BYTES: u64 = 64 << 10;
/// Most pieces of a payload, whose list of 32 bytes each has to fit into one message; larger payloads have larger pieces.
pub const MAX_PIECES: u64 = 1 << 15;
/// Most workers to ask for a stripe before the coordinator.
pub const MAX_SOURCES: usize = 4;
/// Largest message either side decodes: a chunk and its frame, or a long listing.
pub const MAX_MESSAGE_BYTES: usize = CHUNK_BYTES + (64 << 10);
/// Largest result of one lease. Leases are cut far below it.
pub const MAX_RESULT_BYTES: u64 = 1 << 30;
/// Most photons of one batch, and so of one lease's result.
pub const MAX_BATCH_PHOTONS: u64 = 1 << 25;
/// Most rays or left-out samples that one tile or light image may count; keeps their sums within 64 bits.
pub const MAX_RESULT_COUNT: u64 = 1 << 48;
/// Most paths of one bootstrap.
pub const MAX_BOOTSTRAP_PATHS: u64 = 1 << 32;
/// Longest time limit of a job.
pub const MAX_TIME_LIMIT: Duration = Duration::from_secs(366 * 24 * 3600);
/// Largest encoded photon map, bootstrap or sample map.
pub const MAX_MAP_BYTES: u64 = 64 << 30;
/// Largest scene file, buffer or image.
pub const MAX_BLOB_BYTES: u64 = 16 << 30;
/// Largest finished image file.
pub const MAX_IMAGE_BYTES: u64 = 64 << 30;
/// Most external files of a scene.
pub const MAX_EXTERNALS: usize = 16_384;
/// Longest name or URI, in bytes. A data URI never gets here: it stays inside its file.
pub const MAX_NAME_BYTES: usize = 4_096;
/// Longest error text taken from a peer, in bytes; the rest is cut off.
pub const MAX_ERROR_BYTES: usize = 4_096;
/// Highest priority of a job; the lowest is its negative.
pub const MAX_PRIORITY: i32 = 100;
/// Most threads a worker may claim.
pub const MAX_THREADS: u32 = 4_096;
/// Window of one HTTP/2 stream to a server: 4 MiB keeps 1 Gbit/s busy at 30 ms.
pub const STREAM_WINDOW_BYTES: u32 = 4 << 20;
/// Window of one HTTP/2 stream from a server, which bounds by how much the streams of a broadcast that share a link can drift apart: its two
/// streams to a worker keep 1 Gbit/s busy at 16 ms.
pub const BROADCAST_WINDOW_BYTES: u32 = 1 << 20;
/// Window of one HTTP/2 connection.
pub const CONNECTION_WINDOW_BYTES: u32 = 16 << 20;
/// Time between two heartbeats of a worker.
pub const HEARTBEAT: Duration = Duration::from_secs(1);
