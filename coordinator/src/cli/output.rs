//! Where images are written: checked before the work, complete or not there at all.

use super::error::CliError;
use crate::report::{Report, html};
use clap::Args;
use gatherlight_render::export::{decode, png};
use gatherlight_render::film::Film;
use gatherlight_render::math::Rgb;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Where the image goes.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Output")]
pub(super) struct OutputArgs {
    /// Image to write; NAME.png writes NAME.exr and a tone-mapped preview NAME.png beside it
    #[arg(short, long = "output", value_name = "OUT.exr")]
    output: PathBuf,
    /// Write no report beside the image: OUT.report.json for scripts and OUT.report.html for people, with the error over time, the
    /// time of each phase, the plan and all counts
    #[arg(long)]
    no_report: bool,
}

/// The files to write.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Output {
    /// The image.
    pub exr: PathBuf,
    /// The preview, where asked for.
    pub png: Option<PathBuf>,
    /// Whether a report is written beside the image.
    pub report: bool,
}

impl OutputArgs {
    /// Finds out which files are meant, and that they can be written.
    ///
    /// # Errors
    /// When the extension is none that is written, or the directory is missing or not writable.
    pub(super) fn check(&self) -> Result<Output, CliError> {
        let (path, report) = (&self.output, !self.no_report);
        let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        let output = match extension.as_deref() {
            Some("exr") => Output { exr: path.clone(), png: None, report },
            Some("png") => Output { exr: path.with_extension("exr"), png: Some(path.clone()), report },
            _ => {
                return Err(CliError::Usage(format!(
                    "cannot tell what to write from the name {}; end it in .exr, or in .png for an EXR with a preview beside it",
                    path.display()
                )));
            }
        };
        check_writable(&output.exr)?;
        if let Some(png) = &output.png {
            check_writable(png)?;
        }
        Ok(output)
    }
}

impl Output {
    /// Writes a film that was encoded as `exr`, and its preview.
    ///
    /// # Errors
    /// When a file cannot be written; a file that was there before then stays as it was.
    pub(super) fn write_film(&self, film: &Film, exr: &[u8]) -> Result<(), CliError> {
        write_atomically(&self.exr, exr)?;
        match &self.png {
            Some(path) => write_preview(path, film.grid.width, film.grid.height, &film.rgb()),
            None => Ok(()),
        }
    }

    /// Writes an encoded image, and the preview made from it.
    ///
    /// # Errors
    /// When it is no image, or a file cannot be written; a file that was there before then stays as it was.
    pub(super) fn write(&self, exr: &[u8]) -> Result<(), CliError> {
        write_atomically(&self.exr, exr)?;
        let Some(path) = &self.png else { return Ok(()) };
        let image = decode(exr)?;
        let side = |n: usize| u32::try_from(n).map_err(|_| CliError::Failed("the image is too large".into()));
        write_preview(path, side(image.width)?, side(image.height)?, &image.rgb()?)
    }

    /// Writes the report of a job beside its image, if it is wanted.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub(super) fn write_report(&self, report: &Report) -> Result<(), CliError> {
        if !self.report {
            return Ok(());
        }
        let value = report.json();
        let text = serde_json::to_string_pretty(&value).map_err(|e| CliError::Failed(e.to_string()))?;
        write_atomically(&self.exr.with_extension("report.json"), text.as_bytes())?;
        write_atomically(&self.exr.with_extension("report.html"), html::page(&value).as_bytes())
    }

    /// Names of the files, the EXR first.
    pub(super) fn names(&self) -> Vec<String> {
        std::iter::once(&self.exr).chain(&self.png).map(|p| p.display().to_string()).collect()
    }
}

fn write_preview(path: &Path, width: u32, height: u32, pixels: &[Rgb]) -> Result<(), CliError> {
    write_atomically(path, &png::preview(width, height, pixels)?)
}

fn directory(path: &Path) -> &Path {
    match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    }
}

/// Finds out, before any work is done, that `path` can be written.
///
/// # Errors
/// Says which directory is missing or refuses.
pub(super) fn check_writable(path: &Path) -> Result<(), CliError> {
    let parent = directory(path);
    if path.is_dir() {
        return Err(CliError::Usage(format!("cannot write {}: it is a directory", path.display())));
    }
    if !parent.is_dir() {
        let (path, parent) = (path.display(), parent.display());
        return Err(CliError::Usage(format!("cannot write {path}: there is no directory {parent}; make it first")));
    }
    let (temporary, file) = create_temporary(path)
        .map_err(|e| CliError::Usage(format!("cannot write in the directory {}: {e}", parent.display())))?;
    drop(file);
    let _ = std::fs::remove_file(temporary);
    Ok(())
}

/// A new file beside `path` under a name of its own.
fn create_temporary(path: &Path) -> std::io::Result<(PathBuf, File)> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    for attempt in 0..100u32 {
        let temporary = directory(path).join(format!(".{name}.{}-{attempt}.part", std::process::id()));
        match File::options().write(true).create_new(true).open(&temporary) {
            Ok(file) => return Ok((temporary, file)),
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(e),
        }
    }
    Err(std::io::Error::other("no free temporary name"))
}

/// Writes `bytes` under a temporary name, forces them to disk and renames: `path` is the old file or the whole new one.
///
/// # Errors
/// When the disk refuses; the temporary file is then removed.
pub(super) fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), CliError> {
    let fail = |e: std::io::Error| CliError::Failed(format!("cannot write {}: {e}", path.display()));
    let (temporary, mut file) = create_temporary(path).map_err(fail)?;
    let written = file.write_all(bytes).and_then(|()| file.sync_all()).and_then(|()| std::fs::rename(&temporary, path));
    if written.is_err() {
        let _ = std::fs::remove_file(&temporary);
    }
    written.map_err(fail)?;
    // The rename itself is durable once the directory is; where directories cannot be synced the file is still whole.
    let _ = File::open(directory(path)).and_then(|d| d.sync_all());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(path: PathBuf) -> Result<Output, CliError> {
        OutputArgs { output: path, no_report: false }.check()
    }

    #[test]
    fn png_means_both_and_other_endings_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let output = check(dir.path().join("a.b.PNG")).unwrap();
        assert_eq!(output.exr, dir.path().join("a.b.exr"));
        assert_eq!(output.png, Some(dir.path().join("a.b.PNG")));
        for bad in ["a", "a.jpg", "a.exr.gz"] {
            let message = check(dir.path().join(bad)).unwrap_err().to_string();
            assert!(message.contains(bad) && message.contains(".exr"), "{message}");
        }
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "the check leaves nothing behind");
    }

    #[test]
    fn a_file_is_replaced_whole() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.exr");
        write_atomically(&path, b"old").unwrap();
        write_atomically(&path, b"newer").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"newer");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
