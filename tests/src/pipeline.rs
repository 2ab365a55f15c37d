//! The broadcast under a virtual network and clock: the coordinator's own plan, links that are full duplex and take one piece at
//! a time each way, and workers that die on the way.

use gatherlight::broadcast::plan;
use gatherlight_proto::pieces::{Cut, STRIPES};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Every machine's link.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    /// Bytes a second, each way.
    pub bytes_per_second: f64,
    /// Seconds from the last bit sent to the last bit received, with what software adds.
    pub latency: f64,
}

/// A worker that vanishes.
#[derive(Clone, Copy, Debug)]
pub struct Death {
    /// Its place in the plan.
    pub place: usize,
    /// When, in seconds.
    pub at: f64,
}

/// What came of a broadcast.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Seconds until the last surviving worker has everything.
    pub seconds: f64,
    /// Bytes the coordinator sent.
    pub coordinator_bytes: f64,
    /// The most any worker sent, in bytes.
    pub most_bytes: f64,
}

/// No broadcast to `workers` is faster: max(latency ⌈log₂ p⌉, bytes / bandwidth), p counting the coordinator; in seconds.
pub fn bound(workers: usize, bytes: u64, link: Link) -> f64 {
    let hops = (workers + 1).next_power_of_two().ilog2();
    (link.latency * f64::from(hops)).max(bytes as f64 / link.bytes_per_second)
}

/// About how long a broadcast takes, in seconds: all bytes over one link, and a piece down the tree, which passes it on to two.
pub fn estimate(workers: usize, bytes: u64, link: Link) -> f64 {
    let hops = (workers + 1).next_power_of_two().ilog2();
    let piece = Cut { bytes }.piece_bytes().min(bytes) as f64 / link.bytes_per_second;
    bytes as f64 / link.bytes_per_second + f64::from(hops) * (2.0 * piece + link.latency)
}

/// One who passes on a stripe.
#[derive(Clone, Copy)]
struct Stream {
    child: usize,
    stripe: usize,
    /// Piece that is sent next.
    next: u64,
}

#[derive(Default)]
struct Host {
    dead: bool,
    /// Pieces of each stripe that are there, from its first on.
    there: [u64; STRIPES],
    streams: Vec<Stream>,
    turn: usize,
    is_sending: bool,
    receives_until: f64,
    sent: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Due {
    /// The host has sent a piece.
    Sent(usize),
    /// A piece of the stripe arrives at the host from another.
    Arrives {
        host: usize,
        stripe: usize,
        index: u64,
    },
    Dies(usize),
    /// The host asks its next source for the rest of the stripe.
    Resumes(usize, usize),
}

/// Time as an order: nanoseconds.
type Agenda = BinaryHeap<Reverse<(u64, u64, usize)>>;

struct World {
    cut: Cut,
    link: Link,
    /// Seconds after which a source that died is given up.
    silence: f64,
    /// Workers by place, and the coordinator last.
    hosts: Vec<Host>,
    agenda: Agenda,
    due: Vec<Due>,
    now: f64,
}

/// Broadcasts `bytes` to `workers`; who loses its source asks the next one after `silence` seconds.
///
/// # Panics
/// When a surviving worker never gets everything.
pub fn broadcast(workers: usize, bytes: u64, link: Link, deaths: &[Death], silence: f64) -> Outcome {
    let hosts = (0..=workers).map(|_| Host::default()).collect();
    let cut = Cut { bytes };
    let mut world = World { cut, link, silence, hosts, agenda: Agenda::new(), due: Vec::new(), now: 0.0 };
    world.hosts[workers].there = std::array::from_fn(|s| cut.count_in(s));
    for (stripe, place) in (0..STRIPES).flat_map(|s| (0..workers).map(move |p| (s, p))) {
        world.ask(place, stripe);
    }
    for death in deaths {
        world.plan(death.at, Due::Dies(death.place));
    }
    world.send(workers);
    while let Some(Reverse((at, _, due))) = world.agenda.pop() {
        world.now = at as f64 * 1e-9;
        world.happen(world.due[due]);
    }
    let alive = || world.hosts[..workers].iter().filter(|h| !h.dead);
    let complete = |h: &Host| (0..STRIPES).all(|s| h.there[s] == cut.count_in(s));
    assert!(alive().all(complete), "{workers} workers, {bytes} bytes, {deaths:?}: somebody is left without");
    Outcome {
        seconds: alive().map(|h| h.receives_until).fold(0.0, f64::max),
        coordinator_bytes: world.hosts[workers].sent,
        most_bytes: world.hosts[..workers].iter().map(|h| h.sent).fold(0.0, f64::max),
    }
}

impl World {
    fn plan(&mut self, at: f64, due: Due) {
        self.due.push(due);
        let number = self.due.len();
        self.agenda.push(Reverse(((at * 1e9) as u64, number as u64, number - 1)));
    }
    fn workers(&self) -> usize {
        self.hosts.len() - 1
    }
    /// The worker asks the first of its sources that is there for what it lacks of the stripe.
    fn ask(&mut self, place: usize, stripe: usize) {
        if self.hosts[place].there[stripe] == self.cut.count_in(stripe) {
            return;
        }
        let source = plan::sources(stripe, place, self.workers()).find(|&p| !self.hosts[p].dead);
        let source = source.unwrap_or(self.workers());
        let next = stripe as u64 + self.hosts[place].there[stripe] * STRIPES as u64;
        self.hosts[source].streams.push(Stream { child: place, stripe, next });
        self.send(source);
    }
    /// Begins to send a piece that is due, the streams in turn.
    fn send(&mut self, from: usize) {
        let (cut, now, link) = (self.cut, self.now, self.link);
        let host = &mut self.hosts[from];
        if host.is_sending || host.dead {
            return;
        }
        let there = host.there;
        let can = |s: &Stream| s.next < cut.count() && s.next / (STRIPES as u64) < there[s.stripe];
        let count = host.streams.len();
        let Some(i) = (0..count).map(|i| (host.turn + i) % count).find(|&i| can(&host.streams[i])) else { return };
        let Stream { child, stripe, next: index } = host.streams[i];
        host.streams[i].next += STRIPES as u64;
        (host.turn, host.is_sending) = ((i + 1) % count, true);
        let range = cut.range(index);
        let (bytes, seconds) =
            ((range.end - range.start) as f64, (range.end - range.start) as f64 / link.bytes_per_second);
        host.sent += bytes;
        self.plan(now + seconds, Due::Sent(from));
        // The receiver's link takes one piece at a time, too.
        let end = (now + seconds + link.latency).max(self.hosts[child].receives_until + seconds);
        self.hosts[child].receives_until = end;
        self.plan(end, Due::Arrives { host: child, stripe, index });
    }
    fn happen(&mut self, due: Due) {
        match due {
            Due::Sent(host) => {
                self.hosts[host].is_sending = false;
                self.send(host);
            }
            Due::Arrives { host, stripe, index } => {
                let next = stripe as u64 + self.hosts[host].there[stripe] * STRIPES as u64;
                if !self.hosts[host].dead && index == next {
                    self.hosts[host].there[stripe] += 1;
                    self.send(host);
                }
            }
            Due::Dies(host) => {
                self.hosts[host].dead = true;
                let at = self.now + self.silence;
                for Stream { child, stripe, .. } in std::mem::take(&mut self.hosts[host].streams) {
                    self.plan(at, Due::Resumes(child, stripe));
                }
                // Nobody sends to it any more.
                self.hosts.iter_mut().for_each(|h| h.streams.retain(|s| s.child != host));
            }
            Due::Resumes(place, stripe) => {
                if !self.hosts[place].dead {
                    self.ask(place, stripe);
                }
            }
        }
    }
}
