//! The report as one page that needs nothing else: no network, no script.

use serde_json::Value;
use std::fmt::Write;

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 320.0;
const MARGIN: f64 = 56.0;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}\
table{border-collapse:collapse;margin:.5rem 0}td,th{padding:.15rem .8rem .15rem 0;text-align:left;vertical-align:top}\
th{font-weight:600}td.n{text-align:right;font-variant-numeric:tabular-nums}svg text{font:12px system-ui,sans-serif;fill:#444}\
.warn{color:#a40}";

/// The page made of a report for scripts (see `Report::json`).
pub fn page(report: &Value) -> String {
    let mut out = begin(&format!("Gatherlight: {}", text(&report["summary"]["files"][0])));
    paragraphs(&mut out, &text(&report["text"]));
    for warning in list(&report["warnings"]) {
        let _ = writeln!(out, "<p class=\"warn\">Warning: {}</p>", escape(&text(warning)));
    }
    errors(&mut out, &report["timeline"]);
    out.push_str("<h2>Time</h2>\n<table><tr><th>phase</th><th>wall time</th></tr>\n");
    for phase in list(&report["timeline"]["phases"]) {
        row(&mut out, &text(&phase["phase"]), &[seconds(&phase["time_s"])]);
    }
    out.push_str("</table>\n<h2>Counts</h2>\n<table>\n");
    let stats = &report["summary"]["stats"];
    for (key, value) in stats.as_object().into_iter().flatten() {
        if value.is_number() || value.is_string() {
            row(&mut out, &key.replace('_', " "), &[text(value)]);
        }
    }
    row(&mut out, "peak memory of this process (bytes)", &[text(&report["peak_memory_bytes"])]);
    out.push_str("</table>\n");
    if !list(&stats["transfers"]).is_empty() {
        transfers(&mut out, list(&stats["transfers"]));
    }
    if !list(&stats["maps"]).is_empty() {
        out.push_str(
            "<h2>Photon maps</h2>\n<table><tr><th>map</th><th>emitted</th><th>stored</th><th>bytes</th></tr>\n",
        );
        for map in list(&stats["maps"]) {
            row(&mut out, &text(&map["map"]), &["emitted_count", "stored_count", "bytes"].map(|key| text(&map[key])));
        }
        out.push_str("</table>\n");
    }
    out.push_str("<h2>Plan</h2>\n<ul>\n");
    for line in list(&report["plan"]) {
        let _ = writeln!(out, "<li>{}</li>", escape(&text(line)));
    }
    out.push_str("</ul>\n</body></html>\n");
    out
}

fn transfers(out: &mut String, transfers: &[Value]) {
    out.push_str(
        "<h2>Collective operations</h2>\n<p>Broadcasts: time that workers waited for their data. The rest: time from the announcement \
         of a result to its last byte at the coordinator; workers compute meanwhile. Sums over all workers.</p>\n\
         <table><tr><th>operation</th><th>transfers</th><th>bytes</th><th>time</th><th>time of one</th></tr>\n",
    );
    for t in transfers {
        let mean = t["time_s"].as_f64().unwrap_or(0.0) / t["count"].as_f64().unwrap_or(1.0);
        let values = [text(&t["count"]), text(&t["bytes"]), seconds(&t["time_s"]), format!("{:.2} ms", 1e3 * mean)];
        row(out, &text(&t["collective"]), &values);
    }
    out.push_str("</table>\n");
}

/// The beginning of a page, up to and with its title.
pub fn begin(title: &str) -> String {
    let title = escape(title);
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title><style>{STYLE}</style></head>\
         <body>\n<h1>{title}</h1>\n"
    )
}

fn errors(out: &mut String, timeline: &Value) {
    out.push_str("<h2>Error against time</h2>\n");
    let points = |time: &str| -> Vec<[f64; 2]> {
        let all = list(&timeline["error"]).iter();
        all.filter_map(|e| Some([e[time].as_f64()?, e["relative_standard_error"].as_f64()?]))
            .filter(|p| p.iter().all(|v| *v > 0.0))
            .collect()
    };
    for (time, slope, name) in
        [("elapsed_s", "slope_over_elapsed", "wall time"), ("busy_s", "slope_over_busy", "compute time of all workers")]
    {
        let points = points(time);
        if points.len() < 2 {
            out.push_str("<p>The error is not known at more than one moment.</p>\n");
            return;
        }
        let fitted = timeline[slope].as_f64().map_or(String::new(), |s| format!(", slope {s:.2}"));
        let caption = format!("relative standard error over {name} in seconds{fitted}");
        let biases: Vec<[f64; 2]> = list(&timeline["error"])
            .iter()
            .filter_map(|e| Some([e[time].as_f64()?, e["relative_bias"].as_f64()?]))
            .filter(|p| p.iter().all(|v| *v > 0.0))
            .collect();
        let mut curves = vec![Curve { name: "noise".into(), points }];
        if biases.len() > 1 {
            curves.push(Curve { name: "bias".into(), points: biases });
        }
        plot(out, &curves, &caption);
    }
}

/// A named curve of a plot; its coordinates are above 0.
pub struct Curve {
    /// Its name in the legend.
    pub name: String,
    /// Its points, in order.
    pub points: Vec<[f64; 2]>,
}

/// Colours of the curves, told apart by colour-blind readers too (Okabe and Ito 2008).
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];

/// Curves in logarithms on both axes, with lines at powers of ten and their halves; a legend where there are several.
pub fn plot(out: &mut String, curves: &[Curve], caption: &str) {
    let range = |i: usize| {
        let all = curves.iter().flat_map(|c| &c.points);
        let (low, high) = all.fold((f64::INFINITY, 0.0f64), |(a, b), p| (a.min(p[i]), b.max(p[i])));
        let (low, high) = (low.log10(), high.log10());
        let pad = 0.05 * (high - low).max(0.1);
        (low - pad, high + pad)
    };
    // The legend stands beside the curves.
    let right = WIDTH - if curves.len() > 1 { 2.0 } else { 0.5 } * MARGIN;
    let ranges = [range(0), range(1)];
    let place = |i: usize, value: f64| {
        let (low, high) = ranges[i];
        let share = (value.log10() - low) / (high - low);
        if i == 0 { MARGIN + share * (right - MARGIN) } else { HEIGHT - MARGIN - share * (HEIGHT - 1.5 * MARGIN) }
    };
    let _ = write!(out, "<figure><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" role=\"img\">");
    let (left, top, bottom) = (MARGIN, 0.5 * MARGIN, HEIGHT - MARGIN);
    for (i, &(low, high)) in ranges.iter().enumerate() {
        for tick in ticks(low, high) {
            let at = place(i, tick);
            let label = if (0.01..1e4).contains(&tick) { format!("{tick}") } else { format!("{tick:.0e}") };
            let _ = if i == 0 {
                let y = bottom + 16.0;
                write!(
                    out,
                    "<path d=\"M{at:.1} {top}V{bottom}\" stroke=\"#ddd\"/><text x=\"{at:.1}\" y=\"{y}\" \
                     text-anchor=\"middle\">{label}</text>"
                )
            } else {
                let (x, y) = (left - 6.0, at + 4.0);
                write!(
                    out,
                    "<path d=\"M{left} {at:.1}H{right}\" stroke=\"#ddd\"/><text x=\"{x}\" y=\"{y:.1}\" \
                     text-anchor=\"end\">{label}</text>"
                )
            };
        }
    }
    for (i, curve) in curves.iter().enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        let places: Vec<[f64; 2]> = curve.points.iter().map(|p| [place(0, p[0]), place(1, p[1])]).collect();
        let line: Vec<String> = places.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
        let line = line.join(" ");
        let _ = write!(out, "<polyline points=\"{line}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>");
        for [x, y] in &places {
            let _ = write!(out, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"{colour}\"/>");
        }
        if curves.len() > 1 {
            let (x, y, name) = (right + 8.0, top + 16.0 * (i as f64 + 1.0), escape(&curve.name));
            let _ = write!(
                out,
                "<rect x=\"{x}\" y=\"{}\" width=\"12\" height=\"4\" fill=\"{colour}\"/><text x=\"{}\" y=\"{y}\">{name}</text>",
                y - 6.0,
                x + 18.0
            );
        }
    }
    let _ = writeln!(out, "</svg><figcaption>{}</figcaption></figure>", escape(caption));
}

/// 1, 2 and 5 times powers of ten between 10^`low` and 10^`high`; powers alone where that would be many.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let factors: &[f64] = if high - low > 3.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let exponents = low.floor() as i32..=high.ceil() as i32;
    let all = exponents.flat_map(|e| factors.iter().map(move |f| f * 10f64.powi(e)));
    // Written as they are meant: 0.1 · 2, not 0.2 with a tail.
    let rounded = all.map(|t| format!("{t:.3e}").parse().unwrap_or(t));
    rounded.filter(|t: &f64| (low..=high).contains(&t.log10())).collect()
}

fn paragraphs(out: &mut String, text: &str) {
    for line in text.lines() {
        let _ = writeln!(out, "<p>{}</p>", escape(line));
    }
}

fn row(out: &mut String, name: &str, values: &[String]) {
    let cells: String = values.iter().map(|v| format!("<td class=\"n\">{}</td>", escape(v))).collect();
    let _ = writeln!(out, "<tr><td>{}</td>{cells}</tr>", escape(name));
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

fn text(value: &Value) -> String {
    match value {
        Value::String(s) => s.clone(),
        Value::Null => "–".into(),
        other => other.to_string(),
    }
}

fn seconds(value: &Value) -> String {
    value.as_f64().map_or_else(String::new, |s| format!("{s:.2} s"))
}

/// Text as it stands in HTML.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_page_holds_the_plot_the_plan_and_nothing_of_the_network() {
        let error = |t: f64| json!({ "elapsed_s": t, "busy_s": 2.0 * t, "relative_standard_error": 0.1 / t.sqrt() });
        let report = json!({
            "summary": { "files": ["a<b>.exr"], "stats": {
                "rays": 12,
                "maps": [{ "map": "global", "bytes": 5 }],
                "transfers": [{ "collective": "gather tiles", "count": 4, "bytes": 99, "time_s": 0.5 }],
            } },
            "text": "one\ntwo",
            "warnings": ["x & y"],
            "timeline": { "error": [error(1.0), error(3.0), error(20.0)], "slope_over_elapsed": -0.5,
                          "phases": [{ "phase": "gather", "time_s": 1.25 }] },
            "plan": ["computed  all: \"that\""],
            "peak_memory_bytes": 77,
        });
        let page = page(&report);
        for wanted in [
            "a&lt;b&gt;.exr",
            "<svg",
            "slope -0.50",
            "x &amp; y",
            "1.25 s",
            "&quot;that&quot;",
            "77",
            "global",
            "gather tiles",
            "125.00 ms",
        ] {
            assert!(page.contains(wanted), "{wanted} is missing from {page}");
        }
        assert_eq!(page.matches("<svg").count(), 2);
        assert_eq!(page.matches("<circle").count(), 6);
        for unwanted in ["http", "<script", "NaN", "inf"] {
            assert!(!page.contains(unwanted), "{unwanted} is in {page}");
        }
    }

    #[test]
    fn without_errors_the_page_says_so() {
        assert!(page(&json!({})).contains("The error is not known"));
    }

    #[test]
    fn ticks_are_round_numbers_within_the_range() {
        assert_eq!(ticks(-1.1, 0.4), [0.1, 0.2, 0.5, 1.0, 2.0]);
        assert_eq!(ticks(-4.5, 0.1), [1e-4, 1e-3, 1e-2, 1e-1, 1.0]);
    }
}
