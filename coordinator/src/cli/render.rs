//! `gatherlight render`: a whole job on this machine.

use super::error::{CliError, CliResult};
use super::limits::LimitArgs;
use super::output::OutputArgs;
use super::preflight::Preflight;
use super::progress::{JobView, MessageArgs};
use super::scene::{Loaded, SceneArgs};
use crate::embedded;
use crate::report::timeline::Timeline;
use crate::report::{Report, Summary};
use clap::Args;
use gatherlight_render::export;
use gatherlight_render::job::PreparedJob;
use std::sync::Arc;

const EXAMPLES: &str = "\
The scene and the options under Image, Photons, Rounds and Markov chains determine the image, bit for bit: whatever the \
number of threads, here or on a cluster. Each method has options of its own; [photon; default: 60] says whose, and the default.

Examples:
  gatherlight render cornell.glb -o cornell.exr
  gatherlight render cornell.glb -o cornell.png --width 256 --samples 8 --photons 100k
  gatherlight render cornell.glb -o look.png --method whitted
  gatherlight render cornell.glb -o truth.exr --method path --samples 4096
  gatherlight render cornell.glb -o plain.exr --method photon --direct-from-map --photons 10k --k 50
  gatherlight render cornell.glb -o layers.exr --layers direct,indirect,caustic,variance,samples";

/// Render a scene on this machine
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct RenderArgs {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    output: OutputArgs,
    /// Compute threads; 0: one per core
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Run")]
    threads: usize,
    #[command(flatten)]
    limits: LimitArgs,
    /// Treat warnings as errors: no light, no camera, unsupported features
    #[arg(long, help_heading = "Run")]
    strict: bool,
    #[command(flatten)]
    messages: MessageArgs,
}

/// Largest number of compute threads.
const MAX_THREADS: usize = 4096;

pub(super) fn run(args: &RenderArgs) -> CliResult {
    if args.threads > MAX_THREADS {
        return Err(CliError::Usage(format!("--threads: {} is outside 0 … {MAX_THREADS}", args.threads)));
    }
    let output = args.output.check()?;
    let Loaded { bundle, settings, choice } = args.scene.load(args.limits.is_given())?;
    let job = Arc::new(PreparedJob::prepare(&bundle, &settings)?);
    let preflight = Preflight::of(&job, &choice);
    preflight.report_warnings(args.strict)?;
    let limits = args.limits.limits(settings.method, preflight.has_rounds)?;
    args.messages.note(&preflight.text(false));

    let config = embedded::Config { threads: args.threads, limits, ..Default::default() };
    let (mut view, mut timeline) = (JobView::new(args.messages.style(), limits), Timeline::default());
    let result = embedded::render_prepared(&bundle, job, &config, |p| {
        timeline.record(p);
        view.update(p);
    });
    view.end();
    let result = result?;

    output.write_film(&result.film, &export::encode(&result.film, &result.metadata)?)?;
    let summary = Summary { settings, stats: result.stats, elapsed: result.elapsed, files: output.names() };
    let Preflight { plan, warnings, .. } = preflight;
    let report = Report { summary, timeline, plan, warnings };
    output.write_report(&report)?;
    args.messages.print_end(report.summary.json(), &report.summary.text());
    Ok(())
}
