//! Writes the generated scenes into a directory: `cargo run -p gatherlight-tests --example make_scenes -- scenes`.

use gatherlight_tests::scenes;
use std::path::PathBuf;

fn main() -> std::io::Result<()> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "scenes".into()));
    for (name, bytes) in scenes::generated() {
        let path = folder.join(name);
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent)?;
        }
        std::fs::write(&path, &bytes)?;
        println!("{}: {} bytes", path.display(), bytes.len());
    }
    Ok(())
}
