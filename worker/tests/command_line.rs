//! The real program's messages and exit codes.

use std::process::{Command, Output};

fn worker(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_gatherlight-worker")).args(arguments).output().expect("starts")
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn an_unreachable_coordinator_is_named_and_the_exit_code_is_1() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("http://{}", listener.local_addr().expect("an address"));
    drop(listener);
    let output = worker(&["--coordinator", &url, "--attempts", "2"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains(&url) && stderr(&output).contains("2 attempts"), "{}", stderr(&output));
}

#[test]
fn wrong_usage_is_exit_code_2_with_a_way_out() {
    for (arguments, part) in [
        (&["--coordinator", "localhost:7420"][..], "http://localhost:7420"),
        (&["--memory", "lots"], "K, M, G or T"),
        (&["--log", "what=is=this"], "--log"),
        (&["--no-such-flag"], "--help"),
        (&["--token-file", "absent"], "cannot read absent"),
        (&["--tls-cert", "x", "--tls-key", "x"], "--tls-ca"),
        (&["--coordinator", "https://localhost:1"], "--tls-ca"),
    ] {
        let output = worker(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(stderr(&output).contains(part), "{arguments:?}: {}", stderr(&output));
    }
}

#[test]
fn help_names_the_flags() {
    let help = String::from_utf8_lossy(&worker(&["--help"]).stdout).into_owned();
    for flag in [
        "--coordinator",
        "--threads",
        "--memory",
        "--name",
        "--attempts",
        "--token-file",
        "--tls-ca",
        "--metrics",
        "--log",
        "Examples:",
    ] {
        assert!(help.contains(flag), "{flag} is missing from\n{help}");
    }
}
