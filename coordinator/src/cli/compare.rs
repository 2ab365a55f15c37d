//! `gatherlight compare`: how far an image is from a reference.

use super::error::{CliError, CliResult};
use super::output::{check_writable, write_atomically};
use super::{print_json, print_result};
use clap::Args;
use gatherlight_render::export::{decode, png};
use gatherlight_render::film::Image;
use gatherlight_render::film::compare::{Comparison, LEGEND, compare, false_color};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "\
relMSE = mean((a - r)^2 / (r^2 + 0.01)) over pixels and channels; trimmed: without the worst 0.1 % of the pixels; \
bias = mean(a) / mean(r) - 1. The colours are R G B, or those of the first layer that has them.

Examples:
  gatherlight compare image.exr reference.exr
  gatherlight compare image.exr reference.exr --diff where.png
  gatherlight compare image.exr reference.exr --fail-above 0.01 && echo close enough";

/// Compare an EXR image with a reference
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct CompareArgs {
    /// The image
    #[arg(value_name = "A.exr")]
    image: PathBuf,
    /// What it should be
    #[arg(value_name = "REF.exr")]
    reference: PathBuf,
    /// Write a false-colour picture of the relative error of each pixel
    #[arg(long, value_name = "OUT.png")]
    diff: Option<PathBuf>,
    /// Exit with 1 when relMSE is above this
    #[arg(long, value_name = "RELMSE", value_parser = limit)]
    fail_above: Option<f64>,
    /// Print the figures as JSON on stdout
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &CompareArgs) -> CliResult {
    if let Some(path) = &args.diff {
        if path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("png")) {
            return Err(CliError::Usage(format!("--diff: {} must end in .png", path.display())));
        }
        check_writable(path)?;
    }
    let (a, r) = (read(&args.image)?, read(&args.reference)?);
    let colors =
        |path: &Path, image: &Image| image.rgb().map_err(|e| CliError::Failed(format!("{}: {e}", path.display())));
    let (a_rgb, r_rgb) = (colors(&args.image, &a)?, colors(&args.reference, &r)?);
    let c = compare((a.width, a.height, &a_rgb), (r.width, r.height, &r_rgb))?;
    if let Some(path) = &args.diff {
        let side = |n: usize| u32::try_from(n).map_err(|_| CliError::Failed("the image is too large".into()));
        write_atomically(path, &png::encode_rgb8(side(a.width)?, side(a.height)?, &false_color(&c))?)?;
    }
    if args.json {
        print_json(&to_json(&c))
    } else {
        print_result(&to_text(&c, args.diff.as_deref()))
    }
    match args.fail_above {
        Some(limit) if c.relative_mse > limit || c.relative_mse.is_nan() => {
            Err(CliError::Failed(format!("relMSE {:.4e} is above {limit}", c.relative_mse)))
        }
        _ => Ok(()),
    }
}

fn limit(text: &str) -> Result<f64, String> {
    let valid = text.parse().ok().filter(|v: &f64| *v >= 0.0);
    valid.ok_or_else(|| format!("{text:?} is no error; write a number from 0 up, such as 0.01"))
}

pub(super) fn read(path: &Path) -> Result<Image, CliError> {
    let bytes = std::fs::read(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => CliError::Usage(format!("there is no file {}", path.display())),
        _ => CliError::Usage(format!("cannot read {}: {e}", path.display())),
    })?;
    decode(&bytes).map_err(|e| CliError::Failed(format!("{}: {e}", path.display())))
}

fn to_text(c: &Comparison, diff: Option<&Path>) -> String {
    let bias = c.bias.map_or("none (the reference is black)".into(), |b| format!("{:+.4} %", 100.0 * b));
    let mut text = format!(
        "relMSE          {:.4e}\ntrimmed relMSE  {:.4e}\nrelative error  {:.2} % (as renders state theirs)\nMSE             {:.4e}\nRMSE            {:.4e}\n\
         bias            {bias}\nmean            {:.6} against {:.6}",
        c.relative_mse,
        c.trimmed_relative_mse,
        100.0 * c.relative_error,
        c.mse,
        c.rmse,
        c.mean,
        c.reference_mean
    );
    if c.non_finite > 0 {
        text.push_str(&format!("\nnot finite      {} values, counted as 0", c.non_finite));
    }
    if let Some(path) = diff {
        let stops: Vec<String> = LEGEND.iter().map(|(v, _, name)| format!("{name} {} %", v * 100.0)).collect();
        text.push_str(&format!("\n{}: relative error, logarithmic: {}", path.display(), stops.join(", ")));
    }
    text
}

fn to_json(c: &Comparison) -> Value {
    let legend: Vec<Value> = LEGEND.iter().map(|(v, rgb, name)| json!([v, name, rgb])).collect();
    json!({
        "relative_mse": c.relative_mse,
        "trimmed_relative_mse": c.trimmed_relative_mse,
        "relative_error": c.relative_error,
        "mse": c.mse,
        "rmse": c.rmse,
        "bias": c.bias,
        "mean": c.mean,
        "reference_mean": c.reference_mean,
        "pixels": c.pixels,
        "non_finite": c.non_finite,
        "diff_legend": legend,
    })
}
