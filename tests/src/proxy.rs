//! A cable between worker and coordinator that can be cut: what is sent afterwards vanishes, and nobody is told.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How often a cut is looked for.
const LOOK: Duration = Duration::from_millis(20);

/// See the module.
pub struct Cable {
    /// Where to connect to.
    pub url: String,
    cut: Arc<AtomicBool>,
}

impl Cable {
    /// To the server at `address`.
    ///
    /// # Panics
    /// When there is no free port.
    pub fn to(address: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let url = format!("http://{}", listener.local_addr().expect("has an address"));
        let cut = Arc::new(AtomicBool::new(false));
        let (address, is_cut) = (address.to_owned(), cut.clone());
        std::thread::spawn(move || {
            for near in listener.incoming().flatten() {
                let Ok(far) = TcpStream::connect(&address) else { continue };
                for (from, to) in [(&near, &far), (&far, &near)] {
                    let (Ok(from), Ok(to)) = (from.try_clone(), to.try_clone()) else { continue };
                    let is_cut = is_cut.clone();
                    std::thread::spawn(move || carry(from, to, &is_cut));
                }
            }
        });
        Cable { url, cut }
    }
    /// Cuts it, or mends it.
    pub fn set_cut(&self, cut: bool) {
        self.cut.store(cut, Ordering::Relaxed);
    }
}

fn carry(mut from: TcpStream, mut to: TcpStream, is_cut: &AtomicBool) {
    let mut buffer = vec![0; 1 << 16];
    drop(from.set_read_timeout(Some(LOOK)));
    let mut lost = false;
    loop {
        match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => {
                // What was lost once is missing for ever: the connection cannot be mended, only replaced.
                lost |= is_cut.load(Ordering::Relaxed);
                if !lost && to.write_all(&buffer[..n]).is_err() {
                    break;
                }
            }
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => break,
        }
    }
    // Nobody hears of an end across a cut cable.
    while is_cut.load(Ordering::Relaxed) {
        std::thread::sleep(LOOK);
    }
    drop(to.shutdown(std::net::Shutdown::Both));
}
