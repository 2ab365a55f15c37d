//! Writes the first entries of the fuzzers' corpora: `cargo run -p gatherlight-tests --example make_corpora -- fuzz/corpus`.

use gatherlight_tests::fuzz::seeds;
use std::path::PathBuf;

fn main() -> std::io::Result<()> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "fuzz/corpus".into()));
    for (target, name, bytes) in seeds::all() {
        let directory = folder.join(target);
        std::fs::create_dir_all(&directory)?;
        std::fs::write(directory.join(name), bytes)?;
    }
    Ok(())
}
