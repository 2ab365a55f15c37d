//! What is known before any work: the plan and the warnings.

use super::error::CliError;
use super::progress::warn;
use gatherlight_render::import::SceneBundle;
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::settings::RenderSettings;
use serde_json::{Value, json};

/// What a scene and its settings will lead to.
pub(super) struct Preflight {
    /// Digest of the scene.
    pub digest: String,
    /// The plan, line by line.
    pub plan: Vec<String>,
    /// What a user should know.
    pub warnings: Vec<String>,
    /// The plan for scripts.
    pub json: Value,
}

impl Preflight {
    /// Imports and builds the scene and makes the plan.
    ///
    /// # Errors
    /// When the scene or a setting makes no sense.
    pub(super) fn new(bundle: &SceneBundle, settings: &RenderSettings) -> Result<Self, CliError> {
        let job = PreparedJob::prepare(bundle, settings)?;
        let plan = job.phases().iter().map(phase_line).collect();
        let phases: Vec<Value> = job.phases().iter().map(phase_json).collect();
        Ok(Preflight { digest: String::new(), plan, warnings: Vec::new(), json: json!({ "phases": phases }) })
    }

    /// Prints the warnings.
    ///
    /// # Errors
    /// With `strict` a warning is an error.
    pub(super) fn report_warnings(&self, strict: bool) -> Result<(), CliError> {
        if let (true, Some(first)) = (strict, self.warnings.first()) {
            let more = match self.warnings.len() {
                1 => String::new(),
                n => format!(" (and {} more)", n - 1),
            };
            return Err(CliError::Failed(format!("{first}{more}; without --strict this is a warning")));
        }
        self.warnings.iter().for_each(|w| warn(w));
        Ok(())
    }
}

fn phase_line(phase: &Phase) -> String {
    match phase {
        Phase::Emission { map, paths } => {
            format!("emission {}: {} paths", map.name(), super::format::grouped(*paths))
        }
        Phase::Gather { tiles } => format!("gather: {} tiles", super::format::grouped(u64::from(*tiles))),
    }
}

fn phase_json(phase: &Phase) -> Value {
    match phase {
        Phase::Emission { map, paths } => json!({ "phase": "emission", "map": map.name(), "paths": paths }),
        Phase::Gather { tiles } => json!({ "phase": "gather", "tiles": tiles }),
    }
}
