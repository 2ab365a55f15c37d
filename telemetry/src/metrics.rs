//! Counters, and the text that Prometheus reads (exposition format 0.0.4).

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// A number that only grows, until its process ends.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

impl Counter {
    /// Counts `n` more.
    pub fn add(&self, n: u64) {
        self.0.fetch_add(n, Ordering::Relaxed);
    }
    /// The count.
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Numbers that only grow, one for each value of a label.
#[derive(Debug, Default)]
pub struct Labelled(Mutex<BTreeMap<&'static str, u64>>);

impl Labelled {
    /// Counts `n` more for `label`.
    pub fn add(&self, label: &'static str, n: u64) {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(label).or_default();
        *count = count.saturating_add(n);
    }
    /// The counts, for [`Page::labelled`].
    pub fn get(&self) -> Vec<(&'static str, f64)> {
        let counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        counts.iter().map(|(&label, &n)| (label, n as f64)).collect()
    }
}

/// What a number is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// It only grows.
    Counter,
    /// It goes up and down.
    Gauge,
}

/// A page of metrics in the making.
#[derive(Debug, Default)]
pub struct Page(String);

impl Page {
    /// A metric without labels.
    pub fn number(&mut self, kind: Kind, name: &str, help: &str, value: f64) {
        self.labelled(kind, name, help, "", [("", value)]);
    }
    /// A metric with one label, a value for each of its values.
    pub fn labelled<V: AsRef<str>>(
        &mut self,
        kind: Kind,
        name: &str,
        help: &str,
        label: &str,
        values: impl IntoIterator<Item = (V, f64)>,
    ) {
        let kind = match kind {
            Kind::Counter => "counter",
            Kind::Gauge => "gauge",
        };
        // Writing to a string does not fail.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
        for (labelled, value) in values {
            let _ = match label {
                "" => writeln!(self.0, "{name} {value}"),
                _ => writeln!(self.0, "{name}{{{label}=\"{}\"}} {value}", escaped(labelled.as_ref())),
            };
        }
    }
    /// What every process tells of itself.
    pub fn process(&mut self) {
        if let Some(bytes) = crate::memory::resident_bytes() {
            self.number(Kind::Gauge, "process_resident_memory_bytes", "Memory of the process.", bytes as f64);
        }
    }
    /// Its text.
    pub fn into_text(self) -> String {
        self.0
    }
}

/// A label's value, with `\`, `"` and line breaks escaped.
fn escaped(value: &str) -> String {
    value.replace('\\', r"\\").replace('"', "\\\"").replace('\n', r"\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_are_what_prometheus_reads() {
        let counter = Counter::default();
        counter.add(2);
        counter.add(40);
        let mut page = Page::default();
        page.number(Kind::Counter, "x_total", "How many.", counter.get() as f64);
        page.labelled(Kind::Gauge, "y", "By colour.", "colour", [("red", 1.5), ("a\"b\\c\nd", 0.0)]);
        let expected = "\
# HELP x_total How many.
# TYPE x_total counter
x_total 42
# HELP y By colour.
# TYPE y gauge
y{colour=\"red\"} 1.5
y{colour=\"a\\\"b\\\\c\\nd\"} 0
";
        assert_eq!(page.into_text(), expected);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_process_knows_its_memory() {
        let mut page = Page::default();
        page.process();
        let text = page.into_text();
        let value = text.lines().find_map(|l| l.strip_prefix("process_resident_memory_bytes "));
        assert!(value.and_then(|v| v.parse::<f64>().ok()).is_some_and(|v| v > 1e5), "{text}");
    }
}
