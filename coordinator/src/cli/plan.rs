//! `gatherlight plan`: what a render would do, without doing it.

use super::error::CliResult;
use super::preflight::{Preflight, plan_json};
use super::scene::SceneArgs;
use super::{print_json, print_result};
use clap::Args;
use gatherlight_render::export::metadata::settings_text;
use serde_json::json;

const EXAMPLES: &str = "\
Examples:
  gatherlight plan cornell.glb
  gatherlight plan cornell.glb --photons 10M --json
  gatherlight plan cornell.glb --method path
  gatherlight plan cornell.glb --explain
  gatherlight plan cornell.glb --keep-all";

/// Show what a render would compute and what it would leave out, and why
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct PlanArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Treat warnings as errors: no light, no camera, unsupported features
    #[arg(long, help_heading = "Run")]
    strict: bool,
    /// Show below each line what it rests on: materials, textures and who would use them, counts
    #[arg(long, help_heading = "Messages")]
    explain: bool,
    /// Print the plan as JSON on stdout
    #[arg(long, help_heading = "Messages")]
    json: bool,
}

pub(super) fn run(args: &PlanArgs) -> CliResult {
    let loaded = args.scene.load(false)?;
    let job = loaded.prepare()?;
    let preflight = Preflight::of(&job, &loaded.choice);
    let (bundle, settings) = (&loaded.bundle, &loaded.settings);
    preflight.report_warnings(args.strict)?;
    if args.json {
        print_json(&json!({
            "scene": bundle.name,
            "scene_digest": preflight.digest,
            "settings": settings_text(settings),
            "plan": plan_json(&job, &loaded.choice),
            "warnings": preflight.warnings,
        }));
    } else {
        print_result(&format!("{} {}\n{}", bundle.name, settings_text(settings), preflight.text(args.explain)));
    }
    Ok(())
}
