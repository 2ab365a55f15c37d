//! The files of `deploy/`: scripts are run with stand-ins for what a cluster brings, manifests agree with the programs.

use gatherlight_tests::pixel_sha256;
use gatherlight_tests::processes::program;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Ranks on this machine, each with its number, all of which end with the first that fails, and its exit code: what `srun` does as
/// far as the script needs it.
const SRUN: &str = r#"#!/usr/bin/env bash
[ "$1 $2" = "--no-kill --kill-on-bad-exit=1" ] || exit 99
shift 2
set -m
ranks=()
for rank in 0 1 2; do
    SLURM_PROCID=$rank SLURMD_NODENAME=127.0.0.1 "$@" &
    ranks+=($!)
done
for _ in "${ranks[@]}"; do
    wait -n || code=${code:-$?}
    [ -z "$code" ] || for rank in "${ranks[@]}"; do kill -- "-$rank" 2>/dev/null; done
done
exit ${code:-0}
"#;

/// A worker that is killed as it starts on one of the ranks.
const DYING_WORKER: &str = r#"#!/usr/bin/env bash
[ "$SLURM_PROCID" -ne 2 ] || kill -KILL $$
exec "$PROGRAMS/gatherlight-worker" "$@"
"#;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn make_executable(path: &Path, text: &str) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::write(path, text).expect("is written");
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).expect("is made executable");
}

#[test]
fn shell_scripts_have_no_syntax_errors() {
    let scripts = ["deploy/slurm/gatherlight.sbatch", "tests/compose/run.sh", ".ci/run", ".ci/compose", ".ci/deploy"];
    for script in scripts {
        let checked = Command::new("bash").arg("-n").arg(root().join(script)).output().expect("bash runs");
        assert!(checked.status.success(), "{script}: {}", String::from_utf8_lossy(&checked.stderr));
    }
}

#[test]
fn the_slurm_script_renders_on_all_ranks_and_leaves_nothing_behind() {
    let directory = tempfile::tempdir().expect("a directory");
    let at = |name: &str| directory.path().join(name);
    let programs = program("gatherlight").parent().expect("is in a directory").to_owned();
    assert!(program("gatherlight-worker").is_file());
    std::fs::create_dir(at("bin")).expect("is made");
    make_executable(&at("bin/srun"), SRUN);
    let path = format!("{}:{}", at("bin").display(), std::env::var("PATH").expect("is set"));
    let scene = root().join("scenes/cornell-diffuse.glb");
    let options = ["--method", "path", "--width", "32", "--height", "24", "--samples", "4096"];
    let batch = Command::new(root().join("deploy/slurm/gatherlight.sbatch"))
        .arg(&scene)
        .arg(at("slurm.exr"))
        .args(options)
        .env("PATH", &path)
        .env("GATHERLIGHT_BIN", &programs)
        .env("SLURM_JOB_ID", "42")
        .env("SLURM_SUBMIT_DIR", directory.path())
        .output()
        .expect("starts");
    let log = String::from_utf8_lossy(&batch.stderr).into_owned();
    assert!(batch.status.success(), "{log}");
    // All three ranks joined, and none of them minds that the coordinator leaves at the end.
    assert_eq!(log.matches("sessions: joined worker=").count(), 3, "{log}");
    assert!(log.contains("worker=3"), "{log}");
    // A worker that finds the coordinator gone may say so, but nothing fails.
    assert!(!log.contains("ERROR") && !log.contains("error:"), "{log}");
    assert!(!at("gatherlight-42").exists(), "the token and the store are removed");

    let mut render = Command::new(program("gatherlight"));
    render.arg("render").arg(&scene).args(options).arg("-o").arg(at("one.exr"));
    assert!(render.output().expect("starts").status.success());
    let pixels = |name: &str| pixel_sha256(&std::fs::read(at(name)).unwrap_or_else(|e| panic!("{name}: {e}")));
    assert_eq!(pixels("slurm.exr"), pixels("one.exr"));
}

#[test]
fn the_slurm_script_ends_with_the_client_s_exit_code() {
    let directory = tempfile::tempdir().expect("a directory");
    let at = |name: &str| directory.path().join(name);
    let programs = program("gatherlight").parent().expect("is in a directory").to_owned();
    make_executable(&at("srun"), SRUN);
    let path = format!("{}:{}", directory.path().display(), std::env::var("PATH").expect("is set"));
    let mut batch = Command::new(root().join("deploy/slurm/gatherlight.sbatch"));
    batch.arg(at("absent.glb")).arg(at("x.exr")).env("PATH", path).env("GATHERLIGHT_BIN", programs);
    batch.env("SLURM_JOB_ID", "43").env("SLURM_SUBMIT_DIR", directory.path());
    let ended = batch.output().expect("starts");
    let log = String::from_utf8_lossy(&ended.stderr);
    assert!(!ended.status.success() && log.contains("absent.glb"), "{log}");
    assert!(!at("gatherlight-43").exists(), "the token and the store are removed");
    let usage = Command::new(root().join("deploy/slurm/gatherlight.sbatch")).output().expect("starts");
    assert_eq!(usage.status.code(), Some(2));
}

#[test]
fn the_slurm_script_survives_a_worker_and_leaves_what_is_not_its_own() {
    let directory = tempfile::tempdir().expect("a directory");
    let at = |name: &str| directory.path().join(name);
    let programs = program("gatherlight").parent().expect("is in a directory").to_owned();
    for own in ["bin", "shared"] {
        std::fs::create_dir(at(own)).expect("is made");
    }
    std::fs::write(at("shared/mine"), "mine").expect("is written");
    make_executable(&at("bin/srun"), SRUN);
    make_executable(&at("bin/gatherlight-worker"), DYING_WORKER);
    std::os::unix::fs::symlink(programs.join("gatherlight"), at("bin/gatherlight")).expect("is made");
    let path = format!("{}:{}", at("bin").display(), std::env::var("PATH").expect("is set"));
    let batch = Command::new(root().join("deploy/slurm/gatherlight.sbatch"))
        .arg(root().join("scenes/cornell-diffuse.glb"))
        .arg(at("slurm.exr"))
        .args(["--method", "path", "--width", "32", "--height", "24", "--samples", "4096"])
        .env("PATH", &path)
        .env("PROGRAMS", &programs)
        .env("SLURM_JOB_ID", "44")
        .env("GATHERLIGHT_DIR", at("shared"))
        .output()
        .expect("starts");
    let log = String::from_utf8_lossy(&batch.stderr).into_owned();
    assert!(batch.status.success() && at("slurm.exr").is_file(), "{log}");
    assert!(log.contains("ended with exit code 137"), "{log}");
    let left: Vec<_> =
        std::fs::read_dir(at("shared")).expect("is there").map(|e| e.expect("an entry").file_name()).collect();
    assert_eq!(left, ["mine"]);
}

/// Words that begin with `--` in a text, up to `=` or a space.
fn flags(text: &str) -> Vec<&str> {
    let words = text.split(|c: char| c.is_whitespace() || c == '"' || c == '\'');
    let flags = words.filter(|w| w.strip_prefix("--").is_some_and(|name| name.starts_with(char::is_alphabetic)));
    flags.map(|w| w.split('=').next().unwrap_or(w)).collect()
}

#[test]
fn manifests_and_units_give_the_programs_flags_that_they_have() {
    for (file, name, command) in [
        ("deploy/kubernetes/coordinator.yaml", "gatherlight", &["serve", "--help"][..]),
        ("deploy/kubernetes/worker.yaml", "gatherlight-worker", &["--help"]),
        ("deploy/systemd/gatherlight-coordinator.service", "gatherlight", &["serve", "--help"]),
        ("deploy/systemd/gatherlight-worker.service", "gatherlight-worker", &["--help"]),
    ] {
        let text = std::fs::read_to_string(root().join(file)).unwrap_or_else(|e| panic!("{file}: {e}"));
        let text: String = text.lines().filter(|l| !l.trim_start().starts_with('#')).collect::<Vec<_>>().join("\n");
        let help = Command::new(program(name)).args(command).output().expect("starts");
        let help = String::from_utf8_lossy(&help.stdout).into_owned();
        let given = flags(&text);
        assert!(given.len() >= 3, "{file}: {given:?}");
        for flag in given {
            assert!(help.contains(flag), "{file} gives {flag}, which {name} does not have");
        }
    }
}
