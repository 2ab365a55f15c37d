//! A bounded, repeatable run of the fuzzers' targets: the committed corpora, and damage of every kind done to them.

use gatherlight_tests::fuzz::{TARGETS, run, seeds};
use gatherlight_tests::random::Random;
use std::path::Path;

/// Damaged inputs of each target.
const ROUNDS: u64 = 50_000;
/// The same where each takes longer: a scene is loaded three times.
const SLOW_ROUNDS: u64 = 10_000;
/// Longest input that is damaged, in bytes: larger ones take too long here.
const MAX_BYTES: usize = 16 << 10;

fn below(random: &mut Random, n: usize) -> usize {
    random.below(n as u64) as usize
}

fn corpus(target: &str) -> Vec<Vec<u8>> {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus").join(target);
    let entries = std::fs::read_dir(&directory).unwrap_or_else(|e| panic!("{}: {e}", directory.display()));
    let mut paths: Vec<_> = entries.map(|e| e.expect("is readable").path()).collect();
    paths.sort();
    paths.iter().map(|p| std::fs::read(p).unwrap_or_else(|e| panic!("{}: {e}", p.display()))).collect()
}

/// One input with some bytes changed, cut out, repeated, or taken from another.
fn damaged(corpus: &[Vec<u8>], random: &mut Random) -> Vec<u8> {
    let mut bytes = corpus[below(random, corpus.len())].clone();
    for _ in 0..=below(random, 4) {
        let at = below(random, bytes.len());
        let length = below(random, 32).min(bytes.len() - at);
        match below(random, 6) {
            0 if !bytes.is_empty() => bytes[at] ^= 1 << below(random, 8),
            1 if !bytes.is_empty() => bytes[at] = random.next() as u8,
            2 => drop(bytes.drain(at..at + length)),
            3 => {
                let piece = bytes[at..at + length].to_vec();
                bytes.splice(at..at, piece);
            }
            4 => bytes.truncate(at),
            _ => {
                let other = &corpus[below(random, corpus.len())];
                let from = below(random, other.len());
                let piece = other[from..other.len().min(from + length)].to_vec();
                bytes.splice(at..at, piece);
            }
        }
    }
    bytes
}

fn survives(target: &str, rounds: u64) {
    let corpus = corpus(target);
    assert!(corpus.len() >= 3, "{target}: its corpus is too small");
    corpus.iter().for_each(|bytes| run(target, bytes));
    let small: Vec<Vec<u8>> = corpus.into_iter().filter(|bytes| bytes.len() <= MAX_BYTES).collect();
    for round in 0..rounds {
        let bytes = damaged(&small, &mut Random(round));
        let outcome = std::panic::catch_unwind(|| run(target, &bytes));
        // The bytes are what a fuzzer needs to begin from.
        assert!(outcome.is_ok(), "{target}, round {round}: {bytes:?}");
    }
}

#[test]
fn chunks_come_back_from_anything() {
    survives("chunks", ROUNDS);
}

#[test]
fn messages_come_back_from_anything() {
    survives("messages", ROUNDS);
}

#[test]
fn payloads_come_back_from_anything() {
    survives("payloads", ROUNDS);
}

#[test]
fn scenes_come_back_from_anything() {
    survives("gltf", SLOW_ROUNDS);
}

#[test]
fn a_worker_s_session_keeps_its_promises_whatever_comes() {
    survives("session", ROUNDS);
}

#[test]
fn the_scheduler_keeps_its_promises_whatever_comes() {
    survives("schedule", ROUNDS);
}

#[test]
fn every_target_has_a_program_and_its_seeds_are_committed() {
    let fuzz = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz");
    for (target, _) in TARGETS {
        let program = fuzz.join("fuzz_targets").join(format!("{target}.rs"));
        let text = std::fs::read_to_string(&program).unwrap_or_else(|e| panic!("{}: {e}", program.display()));
        assert!(text.contains(&format!("run(\"{target}\"")), "{} runs another target", program.display());
    }
    for (target, name, bytes) in seeds::all() {
        let path = fuzz.join("corpus").join(target).join(name);
        let committed = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        assert_eq!(committed, bytes, "{}: write it anew with the example make_corpora", path.display());
    }
}
