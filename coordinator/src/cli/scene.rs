//! Reading a scene and its external files from disk.

use super::error::CliError;
use super::settings::{SettingsArgs, camera_aspect};
use clap::Args;
use gatherlight_render::auto::Choice;
use gatherlight_render::import::{self, SceneBundle, Wanted};
use gatherlight_render::job::PreparedJob;
use gatherlight_render::scene::description::SceneDescription;
use gatherlight_render::settings::{Method, RenderSettings};
use std::io::Read;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// Largest scene file or external file that is read, in bytes.
const MAX_FILE_BYTES: u64 = 8 << 30;

/// The scene and what determines its image.
#[derive(Args, Clone, Debug)]
pub(super) struct SceneArgs {
    /// glTF 2.0 scene, .glb or .gltf
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    #[command(flatten)]
    settings: SettingsArgs,
}

/// A scene with the settings it is rendered with.
pub(super) struct Loaded {
    /// The scene's files.
    pub(super) bundle: SceneBundle,
    /// The settings, complete.
    pub(super) settings: RenderSettings,
    /// The method, and why.
    pub(super) choice: Choice,
}

impl Loaded {
    /// Imports and builds the scene and makes the plan.
    ///
    /// # Errors
    /// When the scene or a setting makes no sense.
    pub(super) fn prepare(&self) -> Result<PreparedJob, CliError> {
        Ok(PreparedJob::prepare(&self.bundle, &self.settings)?)
    }
}

impl SceneArgs {
    /// Reads the scene with every file it names, and checks the settings. Where a limit will end the job (`limited`), it has no other end
    /// but one that is given.
    ///
    /// # Errors
    /// When a file cannot be read (with its path), or a setting makes no sense.
    pub(super) fn load(&self, limited: bool) -> Result<Loaded, CliError> {
        let args = &self.settings;
        // Nonsense in the options is found before a large scene is read.
        args.check()?;
        let wanted = self.wanted();
        let bundle = read_bundle_for(&self.scene, wanted)?;
        let description = if args.needs_scene() { outline(&bundle, wanted)? } else { SceneDescription::default() };
        let choice = args.method(&description)?;
        let aspect = camera_aspect(&description.cameras, &args.camera());
        drop(description);
        let mut settings = args.settings(choice.method, aspect)?;
        if let Some(memory) = args.memory() {
            let job = PreparedJob::prepare(&bundle, &settings)?;
            args.fit_memory(&mut settings, job.plan(), memory)?;
        }
        let settings = if limited { args.open_ended(settings)? } else { settings };
        Ok(Loaded { bundle, settings, choice })
    }

    /// What of the scene is read.
    fn wanted(&self) -> Wanted {
        Wanted { everything: self.settings.keep_all(), ..Wanted::default() }
    }

    /// Reads the scene with every file it names, and makes the settings of each of `methods`; returns also the one that the scene
    /// asks for.
    ///
    /// # Errors
    /// When a file cannot be read, a setting makes no sense, or one of the methods does not use it.
    pub(super) fn load_for(&self, methods: &[Method]) -> Result<(SceneBundle, Vec<RenderSettings>, Method), CliError> {
        let args = &self.settings;
        if args.names_method() {
            return Err(CliError::Usage("--method: name the methods by --methods".into()));
        }
        let wanted = self.wanted();
        let bundle = read_bundle_for(&self.scene, wanted)?;
        let description = outline(&bundle, wanted)?;
        let aspect = camera_aspect(&description.cameras, &args.camera());
        let settings = methods.iter().map(|&m| args.settings(m, aspect)).collect::<Result<_, _>>()?;
        Ok((bundle, settings, args.method(&description)?.method))
    }
}

/// The scene without what its images hold, on which neither method nor size depends.
fn outline(bundle: &SceneBundle, wanted: Wanted) -> Result<SceneDescription, CliError> {
    import::load_for(bundle, Wanted { images: false, ..wanted }).map_err(|e| CliError::Failed(e.to_string()))
}

/// Reads the scene at `path` with the external files that what is `wanted` needs, relative to its directory.
///
/// # Errors
/// When a file cannot be read, with its path and what named it.
fn read_bundle_for(path: &Path, wanted: Wanted) -> Result<SceneBundle, CliError> {
    let root = read(path, None)?;
    let name = path.file_name().map_or_else(|| path.to_string_lossy(), |n| n.to_string_lossy()).into_owned();
    let uris = import::external_uris_for(&name, &root, wanted).map_err(|e| CliError::Failed(e.to_string()))?;
    let directory = path.parent().unwrap_or(Path::new(""));
    let mut externals = Vec::with_capacity(uris.len());
    for uri in uris {
        let relative = relative_path(&uri).map_err(|why| CliError::Failed(format!("{name}: {why}")))?;
        let bytes = read(&directory.join(relative), Some(&name))?;
        externals.push((uri, bytes));
    }
    Ok(SceneBundle { name, root, externals })
}

fn read(path: &Path, named_by: Option<&str>) -> Result<Arc<[u8]>, CliError> {
    let shown = path.display();
    let by = named_by.map(|n| format!(", which {n} needs")).unwrap_or_default();
    let fail = |what: String| match named_by {
        None => CliError::Usage(what),
        Some(_) => CliError::Failed(what),
    };
    let unreadable = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::NotFound => fail(format!("there is no file {shown}{by}")),
        _ => fail(format!("cannot read {shown}{by}: {e}")),
    };
    let meta = std::fs::metadata(path).map_err(unreadable)?;
    if meta.is_dir() {
        return Err(fail(format!("{shown}{by} is a directory; name the .glb or .gltf file in it")));
    }
    if meta.len() > MAX_FILE_BYTES {
        let limit = format!("over the limit of {MAX_FILE_BYTES} (MAX_FILE_BYTES, fixed at build time)");
        return Err(fail(format!("{shown}{by} has {} bytes, {limit}", meta.len())));
    }
    read_once(path, meta.len()).map_err(unreadable)
}

/// The bytes of a file of `length` bytes, without a second copy of them in memory.
fn read_once(path: &Path, length: u64) -> std::io::Result<Arc<[u8]>> {
    let mut file = std::fs::File::open(path)?;
    let mut bytes: Arc<[u8]> = std::iter::repeat_n(0, usize::try_from(length).unwrap_or(0)).collect();
    if let Some(whole) = Arc::get_mut(&mut bytes) {
        file.read_exact(whole)?;
    }
    // More than it was said to have: it grew meanwhile, or is no regular file.
    let mut rest = Vec::new();
    file.read_to_end(&mut rest)?;
    if rest.is_empty() { Ok(bytes) } else { Ok([&bytes[..], &rest[..]].concat().into()) }
}

/// The path a URI means, relative to the scene's directory.
fn relative_path(uri: &str) -> Result<PathBuf, String> {
    let path = import::relative_path(uri).map(PathBuf::from);
    let path =
        path.ok_or_else(|| format!("{uri:?} is not on this machine; only paths relative to the scene are read"))?;
    let relative = path.components().all(|c| !matches!(c, Component::RootDir | Component::Prefix(_)));
    if relative { Ok(path) } else { Err(format!("the path {uri:?} is absolute; make it relative to the scene")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uris_become_relative_paths() {
        assert_eq!(relative_path("a%20b/c.bin").unwrap(), Path::new("a b/c.bin"));
        assert_eq!(relative_path("../shared/x.png").unwrap(), Path::new("../shared/x.png"));
        assert_eq!(relative_path("caf%C3%A9.bin").unwrap(), Path::new("café.bin"));
        // A percent sign that somebody forgot to encode.
        assert_eq!(relative_path("100%.bin").unwrap(), Path::new("100%.bin"));
        for bad in ["http://host/x.bin", "file:///etc/passwd", "/etc/passwd", "%2Fetc/passwd", "%ff"] {
            assert!(relative_path(bad).is_err(), "{bad}");
        }
    }
}
