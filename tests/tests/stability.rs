//! Stiff and extreme scenes with known answers: those of `gatherlight stability`, small.

use gatherlight::embedded::{self, Config};
use gatherlight::stability::{Answer, Case, Effort, Outcome, Verdict, cases, run};
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::scene;

/// Runs the cases whose number is `part` modulo [`PARTS`].
fn check(part: usize) {
    let chosen: Vec<Case> = cases().into_iter().filter(|c| !c.large).collect();
    let mut wrong = Vec::new();
    for (_, case) in chosen.iter().enumerate().filter(|(i, _)| i % PARTS == part) {
        for method in Method::ALL.into_iter().filter(|m| case.applies(*m)) {
            let outcome = run(case, method, &Effort::SMALL);
            println!("{}", text(&outcome));
            if matches!(outcome.verdict, Verdict::Wrong(_)) {
                wrong.push(text(&outcome));
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}\n", wrong.join("\n"));
}

/// Tests that share the cases, so that several cores are used.
const PARTS: usize = 4;

fn text(o: &Outcome) -> String {
    let (sigmas, time) = (o.sigmas().unwrap_or(0.0), o.slowest.as_secs_f64());
    let reason = o.verdict.reason().unwrap_or_default();
    format!("{}, {}: {} {sigmas:+.1} σ, {time:.3} s {reason}", o.case, o.method.name(), o.verdict.name())
}

#[test]
fn cases_of_the_first_part() {
    check(0);
}

#[test]
fn cases_of_the_second_part() {
    check(1);
}

#[test]
fn cases_of_the_third_part() {
    check(2);
}

#[test]
fn cases_of_the_fourth_part() {
    check(3);
}

#[test]
fn names_are_told_apart_and_reasons_are_given() {
    let all = cases();
    let mut names: Vec<&str> = all.iter().map(|c| c.name.as_str()).collect();
    names.sort_unstable();
    assert!(names.windows(2).all(|w| w[0] != w[1]), "{names:?}");
    for case in &all {
        assert!(Method::ALL.iter().any(|m| case.applies(*m)), "{}: no method applies", case.name);
    }
}

/// A wrong answer is seen: the suite would not be passed by any image at all.
#[test]
fn a_wrong_answer_is_seen() {
    let all = cases();
    let find = |name: &str| all.iter().find(|c| c.name == name).expect("a case of that name").clone();
    let floor = find("1 × 1 pixels");
    let brighter = Case { answer: Answer::Mean { radiance: 0.5, slack: 0.0, blur: 0.0 }, ..floor.clone() };
    let black = Case { answer: Answer::Black, ..floor.clone() };
    let other = Case {
        answer: Answer::SameBits { of: find("sun of 1e9 lux").scene, scale: 1.0, factor: 1.0 },
        ..floor.clone()
    };
    let refused = Case { answer: Answer::Refused("is not finite"), ..floor.clone() };
    let unsaid = Case { warning: Some("clamped"), ..floor };
    for case in [brighter, black, other, refused, unsaid] {
        let outcome = run(&case, Method::Path, &Effort::SMALL);
        assert!(matches!(outcome.verdict, Verdict::Wrong(_)), "{:?} passed", case.answer);
    }
}

/// No sample is left out on any scene of the repository.
#[test]
fn every_sample_of_every_scene_is_finite() {
    let directory = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    let mut names: Vec<String> = std::fs::read_dir(directory)
        .expect("scenes/")
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name.ends_with(".glb"))
        .collect();
    names.sort();
    assert!(names.len() > 10, "the scenes were not found: {names:?}");
    for name in names {
        let bundle = scene(&name);
        for method in Method::ALL {
            let small = RenderSettings { width: 16, height: 16, ..RenderSettings::for_method(method) };
            let settings = RenderSettings {
                samples: 2,
                photons: 2_000,
                caustic_photons: if method == Method::Vcm { 0 } else { 2_000 },
                rounds: 2,
                mutations: 4,
                chains: 4,
                bootstrap: 512,
                ..small
            };
            let config = Config { threads: 1, ..Config::default() };
            let result = embedded::render(&bundle, &settings, &config, |_| ());
            let result = result.unwrap_or_else(|e| panic!("{name}, {}: {e}", method.name()));
            assert_eq!(result.stats.non_finite.total(), 0, "{name}, {}", method.name());
        }
    }
}
