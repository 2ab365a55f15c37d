//! Connections as they come in: how many, how long one may stay that proves nothing or does nothing, how many bytes pass.

use super::{Rate, Tally};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{Instant, Sleep, sleep, sleep_until};
use tokio_stream::Stream;
use tonic::Extensions;
use tonic::transport::server::{Connected, TlsConnectInfo};

/// Pause after the system refused a connection, as it does when files run out.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// Calls that one connection may make a second, and how many at once.
const CALLS_PER_SECOND: u32 = 1_000;

/// Limits of a listener.
#[derive(Clone, Copy, Debug)]
pub struct ConnectionLimits {
    /// Time a connection has until its first call that is allowed: handshakes and headers included.
    pub introduction: Duration,
    /// Connections at once that have made no such call yet. One more crowds out the oldest of them.
    pub unknown: usize,
    /// Connections at once. The system's limit of open files has to be above it.
    pub all: usize,
    /// Time without a [`Call`] after which a connection is closed, or before, where another one needs its place; none: calls are not
    /// told, and it may stay.
    pub idle: Option<Duration>,
}

/// What the listener knows of a connection that is open.
#[derive(Debug)]
struct Place {
    /// Calls that are open.
    calls: usize,
    /// When it came, or its last call ended.
    since: Instant,
    /// Who reads it, to be told that it is closed.
    reader: Option<Waker>,
    flags: Arc<Flags>,
}

#[derive(Debug, Default)]
struct Flags {
    known: AtomicBool,
    closed: AtomicBool,
}

/// All connections that are open, by the order in which they came.
#[derive(Debug, Default)]
struct Places {
    last: u64,
    all: BTreeMap<u64, Place>,
    unknown: BTreeSet<u64>,
}

impl Places {
    /// One more, within `limits`; none where there is no room for it.
    fn take(&mut self, limits: &ConnectionLimits, tally: &dyn Tally) -> Option<(u64, Arc<Flags>)> {
        // Whoever means well has introduced himself before so many others have come.
        if self.unknown.len() >= limits.unknown {
            self.crowd_out(self.unknown.first().copied(), tally);
        }
        if self.all.len() >= limits.all {
            let idle = self.all.iter().filter(|(id, p)| p.calls == 0 && !self.unknown.contains(id));
            let longest = limits.idle.and_then(|_| idle.min_by_key(|(_, p)| p.since)).map(|(&id, _)| id);
            self.crowd_out(longest, tally);
        }
        if self.unknown.len() >= limits.unknown || self.all.len() >= limits.all {
            return None;
        }
        self.last += 1;
        let flags = Arc::new(Flags::default());
        let place = Place { calls: 0, since: Instant::now(), reader: None, flags: flags.clone() };
        self.all.insert(self.last, place);
        self.unknown.insert(self.last);
        Some((self.last, flags))
    }
    fn crowd_out(&mut self, id: Option<u64>, tally: &dyn Tally) {
        if let Some(place) = id.and_then(|id| self.leave(id)) {
            tally.refused("crowded_out");
            place.flags.closed.store(true, Ordering::Relaxed);
            place.reader.into_iter().for_each(Waker::wake);
        }
    }
    fn leave(&mut self, id: u64) -> Option<Place> {
        self.unknown.remove(&id);
        self.all.remove(&id)
    }
}

type Open = Arc<Mutex<Places>>;

fn lock(open: &Open) -> MutexGuard<'_, Places> {
    open.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What is known of the other side of a connection; every call of it carries this.
#[derive(Clone, Debug)]
pub struct Peer(Arc<PeerState>);

#[derive(Debug)]
struct PeerState {
    id: u64,
    address: SocketAddr,
    flags: Arc<Flags>,
    open: Open,
    began: Instant,
    calls: Mutex<Rate>,
}

impl Peer {
    /// The other side of the connection that a call came by; none within this process.
    pub fn of(extensions: &Extensions) -> Option<&Peer> {
        let encrypted = extensions.get::<TlsConnectInfo<Peer>>().map(|info| info.get_ref());
        encrypted.or_else(|| extensions.get::<Peer>())
    }
    /// From where it connects.
    pub fn address(&self) -> SocketAddr {
        self.0.address
    }
    /// It made a call that is allowed: it may stay.
    pub fn introduce(&self) {
        if !self.0.flags.known.swap(true, Ordering::Relaxed) {
            lock(&self.0.open).unknown.remove(&self.0.id);
        }
    }
    /// Whether it made a call that is allowed.
    pub fn is_known(&self) -> bool {
        self.0.flags.known.load(Ordering::Relaxed)
    }
    /// Whether it may make one more call now.
    pub fn may_call(&self) -> bool {
        let now = self.0.began.elapsed();
        self.0.calls.lock().unwrap_or_else(PoisonError::into_inner).admit(now)
    }
    /// A call of it begins; the connection is not idle until it is dropped.
    pub fn begin_call(&self) -> Call {
        lock(&self.0.open).all.entry(self.0.id).and_modify(|p| p.calls += 1);
        Call(self.clone())
    }
}

impl Drop for PeerState {
    fn drop(&mut self) {
        lock(&self.open).leave(self.id);
    }
}

/// A call that is open.
#[derive(Debug)]
pub struct Call(Peer);

impl Drop for Call {
    fn drop(&mut self) {
        let now = Instant::now();
        lock(&self.0.0.open).all.entry(self.0.0.id).and_modify(|p| (p.calls, p.since) = (p.calls - 1, now));
    }
}

/// The connections of a listener, within its limits.
#[derive(Debug)]
pub struct Incoming {
    listener: TcpListener,
    limits: ConnectionLimits,
    tally: Arc<dyn Tally>,
    open: Open,
    pause: Option<Pin<Box<Sleep>>>,
}

impl Incoming {
    /// Those that come to `listener`, counted by `tally`.
    pub fn new(listener: TcpListener, limits: ConnectionLimits, tally: Arc<dyn Tally>) -> Self {
        Incoming { listener, limits, tally, open: Arc::default(), pause: None }
    }
    fn admit(&self, stream: TcpStream, address: SocketAddr) -> Option<Connection> {
        let Some((id, flags)) = lock(&self.open).take(&self.limits, &*self.tally) else {
            self.tally.refused("too_many_connections");
            return None;
        };
        self.tally.connected();
        // Small messages at once; where that cannot be had, they are late and not wrong.
        drop(stream.set_nodelay(true));
        let calls = Mutex::new(Rate::new(CALLS_PER_SECOND));
        let peer =
            Peer(Arc::new(PeerState { id, address, flags, open: self.open.clone(), began: Instant::now(), calls }));
        let timer = Some(Box::pin(sleep(self.limits.introduction)));
        Some(Connection { stream, peer, timer, limits: self.limits, tally: self.tally.clone() })
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
                    self.tally.not_taken(&error);
                    self.pause = Some(Box::pin(sleep(ACCEPT_PAUSE)));
                }
            }
        }
    }
}

/// A TCP connection that ends by itself unless its peer is introduced in time, and does something now and then.
#[derive(Debug)]
pub struct Connection {
    stream: TcpStream,
    peer: Peer,
    /// When to look again whether it may stay; none: it may.
    timer: Option<Pin<Box<Sleep>>>,
    limits: ConnectionLimits,
    tally: Arc<dyn Tally>,
}

impl Connected for Connection {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer.clone()
    }
}

impl Connection {
    /// Whether it may stay open; who reads it is woken when that changes.
    fn may_stay(&mut self, context: &mut Context<'_>) -> io::Result<()> {
        while let Some(timer) = &mut self.timer {
            let is_known = self.peer.is_known();
            if is_known && self.limits.idle.is_none() {
                self.timer = None;
                break;
            }
            if timer.as_mut().poll(context).is_pending() {
                lock(&self.peer.0.open)
                    .all
                    .entry(self.peer.0.id)
                    .and_modify(|p| p.reader = Some(context.waker().clone()));
                break;
            }
            let (Some(idle), true) = (self.limits.idle, is_known) else {
                self.tally.refused("not_introduced");
                return Err(io::ErrorKind::TimedOut.into());
            };
            let (now, places) = (Instant::now(), lock(&self.peer.0.open));
            let place = places.all.get(&self.peer.0.id);
            let until = place.map_or(now, |p| if p.calls > 0 { now + idle } else { p.since + idle });
            drop(places);
            if until <= now {
                self.tally.refused("idle");
                return Err(io::ErrorKind::TimedOut.into());
            }
            *timer = Box::pin(sleep_until(until));
        }
        if self.peer.0.flags.closed.load(Ordering::Relaxed) {
            Err(io::ErrorKind::ConnectionAborted.into())
        } else {
            Ok(())
        }
    }
    fn count(&self, written: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        if let Poll::Ready(Ok(bytes)) = written {
            self.tally.sent(bytes as u64);
        }
        written
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.may_stay(context)?;
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(context, buffer);
        self.tally.received((buffer.filled().len() - before) as u64);
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU64;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio_stream::StreamExt;

    const LIMITS: ConnectionLimits =
        ConnectionLimits { introduction: Duration::from_secs(10), unknown: 256, all: 512, idle: None };

    #[derive(Debug, Default)]
    struct Counts {
        received: AtomicU64,
        refused: Mutex<Vec<&'static str>>,
    }

    impl Tally for Counts {
        fn connected(&self) {}
        fn received(&self, bytes: u64) {
            self.received.fetch_add(bytes, Ordering::Relaxed);
        }
        fn sent(&self, _bytes: u64) {}
        fn not_taken(&self, _error: &io::Error) {}
        fn refused(&self, reason: &'static str) {
            self.refused.lock().expect("is not poisoned").push(reason);
        }
    }

    struct Bench {
        incoming: Incoming,
        address: SocketAddr,
        counts: Arc<Counts>,
    }

    impl Bench {
        async fn new(limits: ConnectionLimits) -> Self {
            let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
            let address = listener.local_addr().expect("an address");
            let counts = Arc::new(Counts::default());
            Bench { incoming: Incoming::new(listener, limits, counts.clone()), address, counts }
        }
        async fn connect(&mut self) -> (TcpStream, Connection) {
            let theirs = TcpStream::connect(self.address).await.expect("connects");
            (theirs, self.incoming.next().await.expect("one").expect("comes"))
        }
        fn refused(&self) -> Vec<&'static str> {
            self.counts.refused.lock().expect("is not poisoned").clone()
        }
        fn open(&self) -> (usize, usize) {
            let places = lock(&self.incoming.open);
            (places.unknown.len(), places.all.len())
        }
    }

    async fn end_of(connection: &mut Connection) -> io::ErrorKind {
        let read = tokio::time::timeout(Duration::from_secs(20), connection.read_u8()).await;
        read.expect("is closed in time").expect_err("is closed").kind()
    }

    #[tokio::test]
    async fn who_is_not_introduced_is_closed_and_who_is_may_stay() {
        let mut b = Bench::new(ConnectionLimits { introduction: Duration::from_millis(100), ..LIMITS }).await;
        let (_silent, mut first) = b.connect().await;
        let (mut friend, mut second) = b.connect().await;
        second.peer.introduce();
        assert_eq!(end_of(&mut first).await, io::ErrorKind::TimedOut);
        friend.write_all(b"xy").await.expect("is sent");
        assert_eq!(second.read_u16().await.expect("is read"), u16::from_be_bytes(*b"xy"));
        assert_eq!(b.counts.received.load(Ordering::Relaxed), 2);
        assert_eq!(b.refused(), ["not_introduced"]);
    }

    #[tokio::test]
    async fn unknown_connections_are_few_and_the_newest_crowds_out_the_oldest() {
        let mut b = Bench::new(ConnectionLimits { unknown: 2, all: 3, ..LIMITS }).await;
        let ((_first, mut oldest), (_second, known)) = (b.connect().await, b.connect().await);
        known.peer.introduce();
        let (_third, _taken) = b.connect().await;
        assert_eq!(b.open(), (2, 3));
        let reading = tokio::spawn(async move { end_of(&mut oldest).await });
        tokio::task::yield_now().await;
        let (_fourth, _taken) = b.connect().await;
        assert_eq!(reading.await.expect("did not panic"), io::ErrorKind::ConnectionAborted);
        assert_eq!((b.open(), b.refused()), ((2, 3), vec!["crowded_out"]));
        // An ended one counts no more.
        drop((known, _taken));
        assert_eq!(b.open(), (1, 1));
    }

    #[tokio::test]
    async fn known_connections_that_may_stay_are_never_crowded_out() {
        let mut b = Bench::new(ConnectionLimits { all: 2, ..LIMITS }).await;
        let (first, second) = (b.connect().await, b.connect().await);
        [&first, &second].iter().for_each(|c| c.1.peer.introduce());
        let mut refused = TcpStream::connect(b.address).await.expect("connects");
        let waited = tokio::time::timeout(Duration::from_millis(100), b.incoming.next()).await;
        assert!(waited.is_err(), "no third one");
        assert_eq!(refused.read(&mut [0]).await.expect("is closed"), 0);
        assert_eq!((b.open(), b.refused()), ((0, 2), vec!["too_many_connections"]));
    }

    #[tokio::test]
    async fn idle_connections_make_room_and_end_and_those_with_a_call_do_not() {
        let limits = ConnectionLimits { all: 2, idle: Some(Duration::from_millis(300)), ..LIMITS };
        let mut b = Bench::new(limits).await;
        let ((_first, mut busy), (_second, mut idle)) = (b.connect().await, b.connect().await);
        [&busy, &idle].iter().for_each(|c| c.peer.introduce());
        let call = busy.peer.begin_call();
        let (_third, mut newest) = b.connect().await;
        assert_eq!(end_of(&mut idle).await, io::ErrorKind::ConnectionAborted);
        newest.peer.introduce();
        // The timer of an introduction runs still; of those who are known it looks at calls.
        newest.timer = Some(Box::pin(sleep(Duration::ZERO)));
        busy.timer = Some(Box::pin(sleep(Duration::ZERO)));
        assert_eq!(end_of(&mut newest).await, io::ErrorKind::TimedOut);
        assert!(tokio::time::timeout(Duration::from_millis(400), busy.read_u8()).await.is_err(), "it may stay");
        drop(call);
        assert_eq!(end_of(&mut busy).await, io::ErrorKind::TimedOut);
        assert_eq!(b.refused(), ["crowded_out", "idle", "idle"]);
    }
}
