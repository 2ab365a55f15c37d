//! The list of what is computed and what is left out, as it is drawn up.

use crate::material::Material;
use crate::scene::Scene;
use crate::scene::description::{PlanEntry, Saving};

/// Names of materials shown as evidence; that there are more is said.
const MAX_NAMES: usize = 16;

/// The entries so far.
#[derive(Default)]
pub(super) struct Entries(pub(super) Vec<PlanEntry>);

impl Entries {
    /// Adds an entry, to be completed.
    pub(super) fn add(&mut self, what: &str, kept: bool, reason: impl Into<String>) -> Completing<'_> {
        self.0.push(PlanEntry { what: what.into(), kept, reason: reason.into(), ..Default::default() });
        Completing(self.0.last_mut())
    }
}

/// The entry that was added last.
pub(super) struct Completing<'e>(Option<&'e mut PlanEntry>);

impl Completing<'_> {
    /// Says what leaving it out saves, on the wire and in memory.
    pub(super) fn saves_bytes(self, wire_bytes: u64, memory_bytes: u64) -> Self {
        self.saves(|s| (s.wire_bytes, s.memory_bytes) = (wire_bytes, memory_bytes))
    }
    /// Says what computation leaving it out saves.
    pub(super) fn saves_work(self, work: impl Into<String>) -> Self {
        self.saves(|s| s.work = work.into())
    }
    fn saves(mut self, set: impl FnOnce(&mut Saving)) -> Self {
        if let Some(entry) = self.0.as_mut().filter(|e| !e.kept) {
            set(&mut entry.saves);
        }
        self
    }
    /// Says what the reason rests on.
    pub(super) fn because(mut self, evidence: impl IntoIterator<Item = String>) -> Self {
        if let Some(entry) = self.0.as_mut() {
            entry.evidence.extend(evidence);
        }
        self
    }
}

/// `what: "A", "B", …` for the materials in use for which `is` holds, with their number.
pub(super) fn materials(scene: &Scene, what: &str, is: impl Fn(&Material) -> bool) -> String {
    let mut used: Vec<u32> = scene.instances.iter().map(|i| scene.meshes[i.mesh as usize].material).collect();
    used.sort_unstable();
    used.dedup();
    let found: Vec<&Material> = used.iter().map(|m| &scene.materials[*m as usize]).filter(|m| is(m)).collect();
    let mut names: Vec<String> = found.iter().take(MAX_NAMES).map(|m| format!("{:?}", m.name())).collect();
    if found.len() > MAX_NAMES {
        names.push("…".into());
    }
    let colon = if names.is_empty() { "" } else { ": " };
    format!("{} of {} materials in use {what}{colon}{}", found.len(), used.len(), names.join(", "))
}
