//! What a finished job says about itself: the attributes of its image, the summary a person or a script reads, and the report
//! beside the image.

pub mod html;
pub mod timeline;

use crate::types::{JobStats, MapStats, NonFinite};
use gatherlight_render::export::{ImageMetadata, MapMetadata};
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::photon::MapKind;
use gatherlight_render::plan::{Plan, PlanEntry};
use gatherlight_render::settings::{Method, RenderSettings, Setting};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;
use timeline::Timeline;

/// What is known of a job's image before it is finished.
#[derive(Clone, Debug)]
pub struct About {
    scene_digest: String,
    plan: Vec<String>,
    has_rounds: bool,
    has_units: bool,
    /// Largest gather radius of each map that is built, in world units.
    pub gather_radii: BTreeMap<MapKind, f32>,
}

impl About {
    /// What `job` says before it starts.
    pub fn new(job: &PreparedJob, phases: &[Phase]) -> Self {
        let (scene_digest, plan) = (job.scene_digest().to_string(), plan_lines(job.plan()));
        let has_units = phases.iter().any(|p| matches!(p, Phase::Splat { .. }));
        let has_gather = phases.iter().any(|p| matches!(p, Phase::Gather { .. }));
        let has_rounds = has_gather && job.settings().method.has_rounds();
        About { scene_digest, plan, has_rounds, has_units, gather_radii: BTreeMap::new() }
    }

    /// Whether it has splat phases.
    pub fn has_units(&self) -> bool {
        self.has_units
    }

    /// The attributes of the finished image: the same wherever the job ran, because nothing in them depends on where
    /// or how fast it did, unless a limit ended it: then they say what was done until then.
    pub fn metadata(&self, settings: &RenderSettings, stats: &JobStats) -> ImageMetadata {
        let map = |m: &MapStats| MapMetadata {
            kind: m.kind,
            emitted_count: m.emitted_count,
            stored_count: m.stored_count,
            k: settings.method.options().contains(&Setting::K).then_some(settings.k),
            max_gather_radius: self.gather_radii.get(&m.kind).copied(),
        };
        ImageMetadata {
            scene_digest: self.scene_digest.clone(),
            settings: settings.clone(),
            maps: stats.maps.iter().map(map).collect(),
            plan: self.plan.clone(),
            non_finite: stats.non_finite.total(),
            samples: samples_done(settings, stats),
            noise: stats.noise,
            bias: stats.bias,
            rounds: self.has_rounds.then_some(stats.rounds_done),
            units: self.has_units.then_some(stats.units_done),
        }
    }
}

/// What is computed and what is left out, with the reason: one line for each reason in a row.
pub fn plan_lines(plan: &Plan) -> Vec<String> {
    plan_groups(plan).map(plan_line).collect()
}

/// Entries of the plan in a row that share a reason.
pub fn plan_groups(plan: &Plan) -> impl Iterator<Item = &[PlanEntry]> {
    plan.entries.chunk_by(|a, b| a.kept == b.kept && a.reason == b.reason)
}

/// The line of a group.
pub fn plan_line(group: &[PlanEntry]) -> String {
    let Some(first) = group.first() else { return String::new() };
    let verb = if first.kept { "computed" } else { "left out" };
    let things: Vec<&str> = group.iter().map(|e| e.what.as_str()).collect();
    format!("{verb}  {}: {}", things.join(", "), first.reason)
}

/// What `render` and `submit` report at the end.
#[derive(Clone, Debug)]
pub struct Summary {
    /// The settings, defaults filled in.
    pub settings: RenderSettings,
    /// Counts.
    pub stats: JobStats,
    /// Wall time.
    pub elapsed: Duration,
    /// Files written, the EXR first.
    pub files: Vec<String>,
}

impl Summary {
    /// For people: two or three lines.
    pub fn text(&self) -> String {
        use crate::cli::format::{count, duration, grouped};
        let (s, t) = (&self.settings, &self.stats);
        let mut text = format!(
            "{}: {} × {}, {}, {} in {}",
            self.files.join(", "),
            s.width,
            s.height,
            s.method.name(),
            effort(s, t),
            duration(self.elapsed)
        );
        for m in &t.maps {
            text.push_str(&format!(
                "\n{} map: {} photons stored of {} paths emitted",
                m.kind.name(),
                grouped(m.stored_count),
                grouped(m.emitted_count)
            ));
        }
        text.push_str(&self.ended_text());
        let rate = t.rays as f64 / self.elapsed.as_secs_f64().max(1e-9);
        text.push_str(&format!("\n{} rays, {}/s", count(t.rays as f64), count(rate)));
        if let (Some(radius), Method::Photon) = (t.gather_radius, s.method) {
            text.push_str(&format!(" · gather radius at most {radius}, k {}", t.k));
        }
        if t.mutations.total() > 0 {
            let [large, small] = t.mutations.acceptance();
            text.push_str(&format!(
                "\n{} mutations in {} chains: accepted {:.0} % of the large steps, {:.0} % of the small ones",
                grouped(t.mutations.total()),
                grouped(t.units_done),
                100.0 * large,
                100.0 * small
            ));
        }
        if let Some(n) = t.noise {
            text.push_str(&format!(" · relative standard error {:.2} %", 100.0 * n.relative));
        }
        if let Some(b) = t.bias {
            text.push_str(&format!(" · relative bias {:.2} %", 100.0 * b.relative));
        }
        let NonFinite { samples, splats, photons } = t.non_finite;
        for (count, what) in [(samples, "samples"), (splats, "splats"), (photons, "photons")] {
            if count > 0 {
                text.push_str(&format!(" · {} {what} were not finite and left out", grouped(count)));
            }
        }
        text
    }

    /// A line on what the image is the mean of, where a limit ended the job early.
    fn ended_text(&self) -> String {
        use crate::cli::format::grouped;
        let (s, t) = (&self.settings, &self.stats);
        let Some(limit) = t.ended_by else { return String::new() };
        let what = match t.units_done {
            0 => {
                let what = if s.method.has_rounds() { "rounds" } else { "samples" };
                let of = if s.is_open_ended() { String::new() } else { format!(" of {}", grouped(s.parts().into())) };
                format!("{}{of} {what}", grouped(samples_per_pixel(s, t).unwrap_or(0).into()))
            }
            units => format!("{} units", grouped(units)),
        };
        format!("\nended by the {} limit: the image is the mean of {what}", limit.name())
    }

    /// For scripts.
    pub fn json(&self) -> Value {
        let (s, t) = (&self.settings, &self.stats);
        json!({
            "files": self.files,
            "method": s.method.name(),
            "width": s.width,
            "height": s.height,
            "samples": samples_per_pixel(s, t),
            "mutations": (s.method == Method::Mlt).then(|| mutations_per_pixel(s, t)),
            "seed": s.seed,
            "elapsed_s": self.elapsed.as_secs_f64(),
            "standard_error": t.noise.map(|n| n.standard_error),
            "relative_standard_error": t.noise.map(|n| n.relative).filter(|r| r.is_finite()),
            "bias": t.bias.map(|b| b.absolute),
            "relative_bias": t.bias.map(|b| b.relative),
            "stats": stats_json(t),
        })
    }
}

/// All that is known of a job at its end, for the files beside its image.
#[derive(Clone, Debug)]
pub struct Report {
    /// What is printed.
    pub summary: Summary,
    /// Its course.
    pub timeline: Timeline,
    /// Lines of the plan.
    pub plan: Vec<String>,
    /// What a user should know.
    pub warnings: Vec<String>,
}

impl Report {
    /// For scripts; units are the last part of a name.
    pub fn json(&self) -> Value {
        json!({
            "gatherlight": gatherlight_render::VERSION,
            "text": self.summary.text(),
            "summary": self.summary.json(),
            "timeline": self.timeline.json(),
            "plan": self.plan,
            "warnings": self.warnings,
            "peak_memory_bytes": peak_memory(),
        })
    }
}

/// The most memory that this process ever held, where the system tells.
fn peak_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let kib =
        text.lines().find_map(|l| l.strip_prefix("VmHWM:")?.trim().strip_suffix("kB")?.trim().parse::<u64>().ok());
    kib.map(|k| k * 1024)
}

/// Camera samples of each pixel that the image is the mean of: one a round, where there are rounds; Markov chains have none of their own.
fn samples_per_pixel(s: &RenderSettings, t: &JobStats) -> Option<u32> {
    match s.method {
        Method::Mlt => None,
        // All of them.
        _ if t.ended_by.is_none() => Some(s.parts()),
        _ if s.has_independent_rounds() => Some(t.units_done as u32),
        m if m.has_rounds() => Some(t.rounds_done),
        _ => samples_done(s, t),
    }
}

/// Camera samples of each pixel that were taken, of methods that have no rounds of their own.
fn samples_done(s: &RenderSettings, t: &JobStats) -> Option<u32> {
    let by_samples = !s.method.has_rounds() && s.method != Method::Mlt && t.rounds_done > 0;
    by_samples.then(|| s.samples_of_round(t.rounds_done.saturating_sub(1)).end)
}

/// Mutations a pixel that were done, of all chains.
fn mutations_per_pixel(s: &RenderSettings, t: &JobStats) -> f64 {
    let share = if t.ended_by.is_some() { t.units_done as f64 / f64::from(s.chains.max(1)) } else { 1.0 };
    f64::from(s.mutations) * share
}

/// How much was computed for each pixel.
fn effort(s: &RenderSettings, t: &JobStats) -> String {
    let plural = |n: &str, what: &str| format!("{n} {what}{}", if n == "1" { "" } else { "s" });
    match samples_per_pixel(s, t) {
        None => {
            let mutations = (mutations_per_pixel(s, t) * 100.0).round() / 100.0;
            format!("{} a pixel", plural(&mutations.to_string(), "mutation"))
        }
        Some(n) => plural(&n.to_string(), if s.method.has_rounds() { "round" } else { "sample" }),
    }
}

/// Counts for scripts; units are the last part of a name.
pub fn stats_json(t: &JobStats) -> Value {
    let maps: Vec<Value> = t
        .maps
        .iter()
        .map(|m| {
            json!({
                "map": m.kind.name(),
                "emitted_count": m.emitted_count,
                "emitted_total": m.emitted_total,
                "stored_count": m.stored_count,
                "bytes": m.bytes,
            })
        })
        .collect();
    let transfers: Vec<Value> = t
        .transfers
        .iter()
        .map(|(kind, t)| {
            json!({ "collective": kind.name(), "count": t.count, "bytes": t.bytes, "time_s": t.time.as_secs_f64() })
        })
        .collect();
    json!({
        "maps": maps,
        "rays": t.rays,
        "non_finite": json!({
            "samples": t.non_finite.samples,
            "splats": t.non_finite.splats,
            "photons": t.non_finite.photons,
        }),
        "mutations": (t.mutations.total() > 0).then(|| json!({
            "large": t.mutations.large,
            "large_accepted": t.mutations.large_accepted,
            "small": t.mutations.small,
            "small_accepted": t.mutations.small_accepted,
        })),
        "gather_radius": t.gather_radius,
        "k": t.k,
        "busy_s": t.busy.as_secs_f64(),
        "workers": t.workers,
        "workers_lost": t.workers_lost,
        "retried_leases": t.retried_leases,
        "repeated_leases": t.repeated_leases,
        "disputes": t.disputes,
        "restarts": t.restarts,
        "transfers": transfers,
        "result_bytes": t.result_bytes,
        "broadcast_bytes": t.broadcast_bytes,
        "rounds_done": t.rounds_done,
        "units_done": t.units_done,
        "ended_by": t.ended_by.map(|l| l.name()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_method_counts_its_own_effort() {
        let all = JobStats::default();
        let of = |method| effort(&RenderSettings { samples: 1, ..RenderSettings::for_method(method) }, &all);
        assert_eq!(of(Method::Path), "1 sample");
        assert_eq!(of(Method::Progressive), "128 rounds");
        assert_eq!(of(Method::Mlt), "64 mutations a pixel");
        assert_eq!(samples_per_pixel(&RenderSettings::for_method(Method::Vcm), &all), Some(64));
    }

    #[test]
    fn a_job_that_a_limit_ended_counts_what_was_done() {
        let ended_by = Some(crate::types::Limit::Time);
        let some = JobStats { rounds_done: 5, units_done: 32, ended_by, ..JobStats::default() };
        let of = |method| effort(&RenderSettings::for_method(method), &some);
        assert_eq!(of(Method::Progressive), "5 rounds");
        // Blocks of 1, 1, 2, 4 and 8 of 64 samples; 32 of 1,024 chains of 64 mutations a pixel in all.
        assert_eq!(of(Method::Path), "16 samples");
        assert_eq!(of(Method::Mlt), "2 mutations a pixel");
    }
}
