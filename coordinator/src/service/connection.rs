//! Connections as they come in: how many, how long one may stay that proves nothing, how many bytes pass.

use super::rate::Rate;
use crate::counters::Counters;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{Instant, Sleep, sleep};
use tokio_stream::Stream;
use tonic::Extensions;
use tonic::transport::server::{Connected, TlsConnectInfo};

/// Time a connection has until its first call that is allowed: handshakes and headers included.
const INTRODUCTION: Duration = Duration::from_secs(10);
/// Connections at once that have made no such call yet. The system's limit of open files has to be above both.
const MAX_UNKNOWN: usize = 256;
/// Connections at once.
const MAX_CONNECTIONS: usize = 8_192;
/// Pause after the system refused a connection, as it does when files run out.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// Calls that one connection may make a second, and how many at once.
const CALLS_PER_SECOND: u32 = 1_000;

/// Limits of a listener.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ConnectionLimits {
    pub(crate) introduction: Duration,
    pub(crate) unknown: usize,
    pub(crate) all: usize,
}

impl Default for ConnectionLimits {
    fn default() -> Self {
        ConnectionLimits { introduction: INTRODUCTION, unknown: MAX_UNKNOWN, all: MAX_CONNECTIONS }
    }
}

#[derive(Debug, Default)]
struct Open {
    unknown: AtomicUsize,
    all: AtomicUsize,
}

/// What is known of the other side of a connection; every call of it carries this.
#[derive(Clone, Debug)]
pub(crate) struct Peer(Arc<PeerState>);

#[derive(Debug)]
struct PeerState {
    address: SocketAddr,
    known: AtomicBool,
    open: Arc<Open>,
    began: Instant,
    calls: Mutex<Rate>,
}

impl Peer {
    /// The other side of the connection that a call came by; none within this process.
    pub(crate) fn of(extensions: &Extensions) -> Option<&Peer> {
        let encrypted = extensions.get::<TlsConnectInfo<Peer>>().map(|info| info.get_ref());
        encrypted.or_else(|| extensions.get::<Peer>())
    }
    /// From where it connects.
    pub(crate) fn address(&self) -> SocketAddr {
        self.0.address
    }
    /// It made a call that is allowed: it may stay.
    pub(crate) fn introduce(&self) {
        if !self.0.known.swap(true, Ordering::Relaxed) {
            self.0.open.unknown.fetch_sub(1, Ordering::Relaxed);
        }
    }
    /// Whether it may make one more call now.
    pub(crate) fn may_call(&self) -> bool {
        let now = self.0.began.elapsed();
        self.0.calls.lock().unwrap_or_else(PoisonError::into_inner).admit(now)
    }
    fn is_known(&self) -> bool {
        self.0.known.load(Ordering::Relaxed)
    }
}

impl Drop for PeerState {
    fn drop(&mut self) {
        self.open.all.fetch_sub(1, Ordering::Relaxed);
        if !*self.known.get_mut() {
            self.open.unknown.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

/// The connections of a listener, within its limits.
#[derive(Debug)]
pub(crate) struct Incoming {
    listener: TcpListener,
    limits: ConnectionLimits,
    counters: Arc<Counters>,
    open: Arc<Open>,
    pause: Option<Pin<Box<Sleep>>>,
}

impl Incoming {
    pub(crate) fn new(listener: TcpListener, limits: ConnectionLimits, counters: Arc<Counters>) -> Self {
        Incoming { listener, limits, counters, open: Arc::default(), pause: None }
    }
    fn admit(&self, stream: TcpStream, address: SocketAddr) -> Option<Connection> {
        let (unknown, all) = (self.open.unknown.load(Ordering::Relaxed), self.open.all.load(Ordering::Relaxed));
        if unknown >= self.limits.unknown || all >= self.limits.all {
            tracing::debug!(%address, unknown, all, "too many connections");
            self.counters.refused("too_many_connections");
            return None;
        }
        self.open.unknown.fetch_add(1, Ordering::Relaxed);
        self.open.all.fetch_add(1, Ordering::Relaxed);
        self.counters.connections.add(1);
        // Small messages at once; where that cannot be had, they are late and not wrong.
        drop(stream.set_nodelay(true));
        let (known, began) = (AtomicBool::new(false), Instant::now());
        let calls = Mutex::new(Rate::new(CALLS_PER_SECOND));
        let peer = Peer(Arc::new(PeerState { address, known, open: self.open.clone(), began, calls }));
        let deadline = Some(Box::pin(sleep(self.limits.introduction)));
        Some(Connection { stream, address, peer, deadline, counters: self.counters.clone() })
    }
}

impl Stream for Incoming {
    type Item = io::Result<Connection>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        loop {
            if let Some(pause) = &mut self.pause {
                ready!(pause.as_mut().poll(context));
                self.pause = None;
            }
            match ready!(self.listener.poll_accept(context)) {
                Ok((stream, address)) => {
                    if let Some(connection) = self.admit(stream, address) {
                        return Poll::Ready(Some(Ok(connection)));
                    }
                }
                Err(error) => {
                    tracing::warn!(%error, "a connection could not be taken");
                    self.counters.refused("accept_failed");
                    self.pause = Some(Box::pin(sleep(ACCEPT_PAUSE)));
                }
            }
        }
    }
}

/// A TCP connection that ends by itself unless its peer is introduced in time.
#[derive(Debug)]
pub(crate) struct Connection {
    stream: TcpStream,
    address: SocketAddr,
    peer: Peer,
    /// Until the peer is known.
    deadline: Option<Pin<Box<Sleep>>>,
    counters: Arc<Counters>,
}

impl Connected for Connection {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer.clone()
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.peer.is_known() {
            self.deadline = None;
        }
        if let Some(deadline) = &mut self.deadline
            && deadline.as_mut().poll(context).is_ready()
        {
            tracing::debug!(address = %self.address, "a connection was not introduced in time");
            self.counters.refused("not_introduced");
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(context, buffer);
        self.counters.received_bytes.add((buffer.filled().len() - before) as u64);
        read
    }
}

impl AsyncWrite for Connection {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.count(written)
    }
    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        pieces: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, pieces);
        self.count(written)
    }
    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }
    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

impl Connection {
    fn count(&self, written: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        if let Poll::Ready(Ok(bytes)) = written {
            self.counters.sent_bytes.add(bytes as u64);
        }
        written
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio_stream::StreamExt;

    async fn listening(limits: ConnectionLimits) -> (Incoming, SocketAddr) {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        (Incoming::new(listener, limits, Arc::default()), address)
    }

    #[tokio::test]
    async fn who_is_not_introduced_is_closed_and_who_is_may_stay() {
        let limits = ConnectionLimits { introduction: Duration::from_millis(100), ..ConnectionLimits::default() };
        let (mut incoming, address) = listening(limits).await;
        let (_silent, mut friend) =
            (TcpStream::connect(address).await, TcpStream::connect(address).await.expect("connects"));
        let mut first = incoming.next().await.expect("one").expect("comes");
        let mut second = incoming.next().await.expect("another").expect("comes");
        second.peer.introduce();
        assert_eq!(first.read_u8().await.expect_err("is closed").kind(), io::ErrorKind::TimedOut);
        friend.write_all(b"xy").await.expect("is sent");
        assert_eq!(second.read_u16().await.expect("is read"), u16::from_be_bytes(*b"xy"));
        assert_eq!(incoming.counters.received_bytes.get(), 2);
        assert_eq!(incoming.counters.refusals().get("not_introduced"), Some(&1));
    }

    #[tokio::test]
    async fn unknown_connections_are_few_and_make_room_when_they_end() {
        let limits = ConnectionLimits { unknown: 2, all: 3, ..ConnectionLimits::default() };
        let (mut incoming, address) = listening(limits).await;
        let mut kept = Vec::new();
        let mut taken = Vec::new();
        for _ in 0..2 {
            kept.push(TcpStream::connect(address).await.expect("connects"));
            taken.push(incoming.next().await.expect("one").expect("comes"));
        }
        let mut refused = TcpStream::connect(address).await.expect("connects");
        let waited = tokio::time::timeout(Duration::from_millis(100), incoming.next()).await;
        assert!(waited.is_err(), "no third one");
        assert_eq!(refused.read(&mut [0]).await.expect("is closed"), 0);
        // A known one counts no more as unknown; an ended one counts no more at all.
        taken[0].peer.introduce();
        let _third = TcpStream::connect(address).await.expect("connects");
        let _taken = incoming.next().await.expect("one").expect("comes");
        assert_eq!((incoming.open.unknown.load(Ordering::Relaxed), incoming.open.all.load(Ordering::Relaxed)), (2, 3));
        taken.clear();
        assert_eq!((incoming.open.unknown.load(Ordering::Relaxed), incoming.open.all.load(Ordering::Relaxed)), (1, 1));
    }
}
