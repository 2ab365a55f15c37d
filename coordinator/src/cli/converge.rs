//! `gatherlight converge`: error over time of several methods on one scene.

use super::error::{CliError, CliResult};
use super::format::{self, duration, grouped, parse_duration};
use super::output::{check_writable, write_atomically};
use super::progress::warn;
use super::scene::SceneArgs;
use super::{compare, print_json, print_result};
use crate::compute::Compute;
use crate::converge::{Course, course};
use crate::report::html::{Curve, begin, escape, plot};
use clap::Args;
use gatherlight_render::import::SceneBundle;
use gatherlight_render::math::Rgb;
use gatherlight_render::settings::{Method, RenderSettings};
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::PathBuf;
use std::time::Duration;

const EXAMPLES: &str = "\
relMSE is that of `gatherlight compare`. The noise and the bias are what each image states of itself; the reference tells \
whether that is true. Without a reference one is made, by the method that can reach all of the scene's light, in four \
times the time; its own error bounds what can be seen.

Examples:
  gatherlight converge cornell.glb --width 256 --time 20s
  gatherlight converge cornell.glb --methods path,bdpt,vcm --time 1m --reference truth.exr -o errors.csv";

/// Seeds of the reference are not those of the images compared with it.
const REFERENCE_SEED: u64 = 1 << 40;
/// Time of the reference that is made, over that of each method.
const REFERENCE_TIME: u32 = 4;

/// Compare methods on one scene: error over time, in a table, a CSV file and a plot
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct ConvergeArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Methods, separated by commas; all: every one whose image goes to the truth
    #[arg(long, value_name = "METHOD,…", default_value = "all", help_heading = "Run")]
    methods: String,
    /// Time for each method, e.g. 30s or 5m
    #[arg(long, value_name = "TIME", value_parser = parse_duration, default_value = "20s", help_heading = "Run")]
    time: Duration,
    /// What the image should be; its size decides that of the images
    #[arg(long, value_name = "REF.exr", help_heading = "Run")]
    reference: Option<PathBuf>,
    /// Compute threads; 0: one per core
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Run")]
    threads: usize,
    /// Write all points to this file, and a plot to the file of the same name in .html
    #[arg(short, long = "output", value_name = "OUT.csv", help_heading = "Output")]
    output: Option<PathBuf>,
    /// Print the courses as JSON on stdout
    #[arg(long, help_heading = "Messages")]
    json: bool,
}

pub(super) fn run(args: &ConvergeArgs) -> CliResult {
    let methods = methods(&args.methods)?;
    if let Some(path) = &args.output {
        if path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("csv")) {
            return Err(CliError::Usage(format!("--output: {} must end in .csv", path.display())));
        }
        check_writable(path)?;
        check_writable(&path.with_extension("html"))?;
    }
    let (bundle, settings, auto) = args.scene.load_for(&methods)?;
    let compute = Compute::new(args.threads).map_err(CliError::Failed)?;
    let truth = reference(args, &bundle, &settings, auto, &compute)?;
    let mut courses = Vec::new();
    for s in &settings {
        eprintln!("{}: {} …", s.method.name(), duration(args.time));
        courses.push(compute.pool().install(|| course(&bundle, s, args.time, Some(&truth.pixels)))?);
    }
    if let Some(path) = &args.output {
        write_atomically(path, csv(&courses).as_bytes())?;
        let page = page(&bundle.name, &truth.said, &courses);
        write_atomically(&path.with_extension("html"), page.as_bytes())?;
    }
    if args.json {
        print_json(&json!({ "reference": truth.said, "courses": courses.iter().map(to_json).collect::<Vec<_>>() }));
    } else {
        print_result(&format!("reference: {}\n{}", truth.said, table(&courses)));
    }
    Ok(())
}

fn methods(text: &str) -> Result<Vec<Method>, CliError> {
    if text == "all" {
        return Ok(Method::ALL.into_iter().filter(|m| m.is_consistent()).collect());
    }
    let one = |name: &str| {
        let found = Method::ALL.into_iter().find(|m| m.name() == name.trim());
        let all: Vec<&str> = Method::ALL.into_iter().map(Method::name).collect();
        found.ok_or_else(|| CliError::Usage(format!("--methods: {name:?} is none of {}, or all", all.join(", "))))
    };
    text.split(',').map(one).collect()
}

/// What the images are compared with.
struct Reference {
    pixels: Vec<Rgb>,
    /// Where it comes from and how good it is.
    said: String,
}

fn reference(
    args: &ConvergeArgs,
    bundle: &SceneBundle,
    settings: &[RenderSettings],
    auto: Method,
    compute: &Compute,
) -> Result<Reference, CliError> {
    let Some(first) = settings.first() else { return Err(CliError::Usage("--methods: names none".into())) };
    let (width, height) = (first.width, first.height);
    if let Some(path) = &args.reference {
        let image = compare::read(path)?;
        if (image.width, image.height) != (width as usize, height as usize) {
            return Err(CliError::Usage(format!(
                "--reference: {} has {} × {} pixels, the images have {width} × {height}; give --width {} --height {}",
                path.display(),
                image.width,
                image.height,
                image.width,
                image.height
            )));
        }
        return Ok(Reference { pixels: image.rgb()?, said: path.display().to_string() });
    }
    // Where photons are asked for, light may be focused in ways that only merging finds.
    let method = if auto == Method::Progressive { Method::Vcm } else { Method::Path };
    let base = RenderSettings::for_method(method);
    let seed = first.seed.wrapping_add(REFERENCE_SEED);
    let settings = RenderSettings { width, height, seed, camera: first.camera.clone(), ..base };
    let time = args.time * REFERENCE_TIME;
    eprintln!("making a reference by {}: {} …", method.name(), duration(time));
    let made = compute.pool().install(|| course(bundle, &settings, time, None))?;
    let percent = |v: Option<f64>| v.map_or("unknown".into(), |v| format!("{:.2} %", 100.0 * v));
    let last = made.last();
    let (noise, bias) = (last.and_then(|p| p.noise), last.and_then(|p| p.bias));
    let said = match method {
        Method::Vcm => format!("made by vcm; its own noise is {}, its bias {}", percent(noise), percent(bias)),
        _ => format!("made by {}; its own noise is {}", method.name(), percent(noise)),
    };
    if noise.is_none_or(|n| n > 0.05) {
        warn("the reference is noisy: errors below its own are not seen; give more --time, or a --reference");
    }
    Ok(Reference { pixels: made.image, said })
}

fn table(courses: &[Course]) -> String {
    let percent = |v: Option<f64>| v.map_or("–".into(), |v| format!("{:.2} %", 100.0 * v));
    let row = |c: &Course| {
        let p = c.last()?;
        Some(vec![
            c.method.name().into(),
            duration(p.elapsed),
            grouped(p.parts),
            percent(p.noise),
            percent(p.bias),
            percent(p.error),
            p.relative_mse.map_or("–".into(), |e| format!("{e:.2e}")),
            c.slope().map_or("–".into(), |s| format!("{s:.2}")),
        ])
    };
    let rows: Vec<Vec<String>> = courses.iter().filter_map(row).collect();
    format::table(&["method", "time", "parts", "noise", "bias", "real", "relMSE", "slope"], &rows)
}

fn csv(courses: &[Course]) -> String {
    let mut out =
        String::from("method,elapsed_s,parts,relative_standard_error,relative_bias,relative_mse,relative_error\n");
    let number = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
    for (c, p) in courses.iter().flat_map(|c| c.points.iter().map(move |p| (c, p))) {
        let [noise, bias, mse, error] = [p.noise, p.bias, p.relative_mse, p.error].map(number);
        let _ =
            writeln!(out, "{},{},{},{noise},{bias},{mse},{error}", c.method.name(), p.elapsed.as_secs_f64(), p.parts);
    }
    out
}

fn to_json(c: &Course) -> Value {
    let points: Vec<Value> = c
        .points
        .iter()
        .map(|p| {
            json!({
                "elapsed_s": p.elapsed.as_secs_f64(),
                "parts": p.parts,
                "relative_standard_error": p.noise.filter(|v| v.is_finite()),
                "relative_bias": p.bias,
                "relative_mse": p.relative_mse,
                "relative_error": p.error,
            })
        })
        .collect();
    json!({ "method": c.method.name(), "slope": c.slope(), "points": points })
}

fn page(scene: &str, reference: &str, courses: &[Course]) -> String {
    let mut out = begin(&format!("Gatherlight: error over time, {scene}"));
    let _ = writeln!(out, "<p>Reference: {}</p>", escape(reference));
    let curves = |value: &dyn Fn(&crate::converge::Point) -> Option<f64>| -> Vec<Curve> {
        let curve = |c: &Course| {
            let points = c.points.iter().filter_map(|p| Some([p.elapsed.as_secs_f64(), value(p)?]));
            let points = points.filter(|p| p.iter().all(|v| v.is_finite() && *v > 0.0)).collect();
            Curve { name: c.method.name().into(), points }
        };
        courses.iter().map(curve).filter(|c| c.points.len() > 1).collect()
    };
    for (curves, caption) in [
        (curves(&|p| p.relative_mse), "relMSE against the reference over time in seconds"),
        (curves(&|p| p.noise), "relative standard error as stated over time in seconds"),
    ] {
        if !curves.is_empty() {
            plot(&mut out, &curves, caption);
        }
    }
    let _ = writeln!(out, "<pre>{}</pre>\n</body></html>", escape(&table(courses)));
    out
}
