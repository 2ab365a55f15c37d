//! Peers that mean no good.

use crate::cluster::PATIENCE;
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// What opens an HTTP/2 connection: the preface and empty settings.
pub const HTTP2_HANDSHAKE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

/// A connection that sends `first` and then a byte now and then; the time until it was closed.
///
/// # Panics
/// When it is not closed within [`PATIENCE`].
pub async fn drip(address: SocketAddr, first: &[u8]) -> Duration {
    let begin = Instant::now();
    let (mut reading, mut writing) = TcpStream::connect(address).await.expect("connects").into_split();
    writing.write_all(first).await.expect("is sent");
    let dripping = async {
        // Bytes of the HTTP/2 preface, slowly, and for ever.
        for byte in HTTP2_HANDSHAKE.iter().cycle() {
            tokio::time::sleep(Duration::from_secs(1)).await;
            if writing.write_all(&[*byte]).await.is_err() {
                return;
            }
        }
    };
    let closed = async {
        let mut answer = Vec::new();
        drop(reading.read_to_end(&mut answer).await);
    };
    let closing = async {
        tokio::select! {
            () = dripping => {}
            () = closed => {}
        }
    };
    tokio::time::timeout(PATIENCE, closing).await.expect("is closed in time");
    begin.elapsed()
}

/// Opens `count` connections: a third of them silent, a third with half a handshake, a third with a whole one and no call.
///
/// # Panics
/// When they cannot be opened.
pub async fn crowd(address: SocketAddr, count: usize) -> Vec<TcpStream> {
    let mut held = Vec::with_capacity(count);
    for i in 0..count {
        let mut stream = TcpStream::connect(address).await.expect("connects");
        drop(stream.write_all(&HTTP2_HANDSHAKE[..HTTP2_HANDSHAKE.len() * (i % 3) / 2]).await);
        held.push(stream);
    }
    held
}

/// Those of `connections` that the other side has not closed.
pub fn still_open(connections: &[TcpStream]) -> usize {
    let is_open = |stream: &&TcpStream| {
        let mut buffer = [0; 1_024];
        loop {
            match stream.try_read(&mut buffer) {
                Ok(0) => return false,
                Ok(_) => {}
                Err(error) => return error.kind() == std::io::ErrorKind::WouldBlock,
            }
        }
    };
    connections.iter().filter(is_open).count()
}
