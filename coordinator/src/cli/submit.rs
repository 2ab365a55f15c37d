//! `gatherlight submit`: renders on a cluster.

use super::connection::ConnectionArgs;
use super::error::{CliError, CliResult};
use super::fetch::fetch_to;
use super::format::bytes;
use super::limits::LimitArgs;
use super::output::{Output, OutputArgs};
use super::preflight::{Preflight, lacks_memory, report_warnings};
use super::progress::{MessageArgs, Style};
use super::scene::{Loaded, SceneArgs};
use super::watch::{follow, interrupted, outcome};
use super::{json, print_json, print_result};
use crate::client::{Client, SubmitRequest};
use crate::report::{Report, Summary};
use crate::types::JobId;
use clap::Args;
use gatherlight_render::settings::RenderSettings;
use serde_json::{Value, json};

const EXAMPLES: &str = "\
Ctrl-C leaves the job running and says how to return to it.

Examples:
  gatherlight submit cornell.glb -o cornell.exr --coordinator http://host:7420
  gatherlight submit cornell.glb -o cornell.exr --samples 1k --detach";

/// Render a scene on a cluster; the image has the same bits as that of `render`
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct SubmitArgs {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    connection: ConnectionArgs,
    /// Submit, print the job's id and return; `gatherlight fetch` gets the image later
    #[arg(long, help_heading = "Run")]
    detach: bool,
    #[command(flatten)]
    limits: LimitArgs,
    /// Name in listings [default: the scene file's]
    #[arg(long, value_name = "NAME", help_heading = "Run")]
    name: Option<String>,
    /// Jobs of higher priority get workers first; jobs of the same one share them
    #[arg(long, value_name = "N", help_heading = "Run", default_value_t = 0, allow_negative_numbers = true,
        value_parser = clap::value_parser!(i32).range(-100..=100))]
    priority: i32,
    /// Treat warnings as errors: no light, no camera, unsupported features
    #[arg(long, help_heading = "Run")]
    strict: bool,
    #[command(flatten)]
    messages: MessageArgs,
}

pub(super) fn run(args: &SubmitArgs) -> CliResult {
    let output = args.output.check()?;
    let loaded = args.scene.load(args.limits.is_given())?;
    let preflight = Preflight::of(&loaded.prepare()?, &loaded.choice);
    preflight.report_warnings(args.strict)?;
    let limits = args.limits.limits(loaded.settings.method, preflight.has_rounds)?;
    args.messages.note(&preflight.text(false));
    let Loaded { bundle, settings, .. } = loaded;
    let Preflight { plan, warnings, worker_bytes, .. } = preflight;
    let name = args.name.clone().unwrap_or_else(|| bundle.name.clone());
    let request = SubmitRequest { name, bundle, settings, limits, priority: args.priority };
    args.connection.run(|client| async move {
        let small = lacks_memory(worker_bytes, &client.workers().await?);
        report_warnings(small.as_slice(), args.strict)?;
        submit(client, args, request, output, [plan, [warnings, Vec::from_iter(small)].concat()]).await
    })
}

async fn submit(
    client: Client,
    args: &SubmitArgs,
    request: SubmitRequest,
    output: Output,
    [plan, warnings]: [Vec<String>; 2],
) -> CliResult {
    let bars = args.messages.style() == Style::Bars;
    let upload = |sent, total| {
        if bars {
            eprint!("\ruploading the scene: {} of {} ", bytes(sent), bytes(total));
        }
    };
    let id = tokio::select! {
        id = client.submit(&request, upload) => id?,
        () = interrupted() => {
            eprintln!("\ninterrupted before the coordinator took the job");
            return Err(CliError::Interrupted);
        }
    };
    if bars {
        eprintln!("\r\x1b[Kjob {id}");
    }
    if args.detach {
        detached(args, &client, id, &output);
        return Ok(());
    }
    let finish = async {
        let (last, timeline) = follow(&client, id, request.limits, args.messages).await?;
        outcome(&last)?;
        let digest = fetch_to(client.clone(), id, &output).await?;
        Ok::<_, CliError>((last, timeline, digest))
    };
    let (last, timeline, digest) = tokio::select! {
        done = finish => done?,
        () = interrupted() => {
            eprintln!("\n{}", how_to_return(client.url(), id, &output));
            return Err(CliError::Interrupted);
        }
    };
    let summary = summary(request.settings, &last, &output);
    let report = Report { summary, timeline, plan, warnings };
    output.write_report(&report)?;
    let (json, text) = (report.summary.json(), report.summary.text());
    args.messages.print_end(with_job(json, json::job(&last), &digest), &text);
    Ok(())
}

fn summary(settings: RenderSettings, last: &crate::types::JobProgress, output: &Output) -> Summary {
    Summary { settings, stats: last.stats.clone(), elapsed: last.elapsed, files: output.names() }
}

fn with_job(mut summary: Value, job: Value, digest: &str) -> Value {
    summary["id"] = job["id"].clone();
    summary["digest"] = json!(digest);
    summary
}

fn detached(args: &SubmitArgs, client: &Client, id: JobId, output: &Output) {
    if args.messages.json {
        print_json(&json!({ "id": id.to_string(), "coordinator": client.url() }));
    } else {
        print_result(&id.to_string());
        args.messages.note(&how_to_return(client.url(), id, output));
    }
}

/// The commands that lead back to a running job.
fn how_to_return(url: &str, id: JobId, output: &Output) -> String {
    let out = output.png.as_ref().unwrap_or(&output.exr).display();
    format!(
        "job {id} goes on; to return to it:\n  gatherlight watch {id} --coordinator {url}\n  \
         gatherlight fetch {id} -o {out} --coordinator {url}\n  gatherlight cancel {id} --coordinator {url}"
    )
}
