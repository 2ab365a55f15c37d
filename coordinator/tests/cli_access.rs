//! What the real program says where a coordinator can be reached by others, and where a token or certificate is at fault.

mod common;

use common::run;

const SECRET: &str = "whole-SECRET-0123456789";

#[test]
fn a_coordinator_that_others_reach_asks_for_proof_before_anything_starts() {
    let dir = tempfile::tempdir().unwrap();
    let refused = run(dir.path(), "serve --listen 0.0.0.0:0");
    refused.says(2, &["error: 0.0.0.0:0", "--token-file", "--tls-client-ca", "--insecure"]);
    assert!(!dir.path().join("gatherlight-store").exists(), "nothing was made");
    run(dir.path(), "serve --listen 0.0.0.0:0 --token-file absent").says(2, &["cannot read absent"]);
    run(dir.path(), "serve --tls-cert x").says(2, &["--tls-cert and --tls-key belong together"]);
}

#[test]
fn faults_of_a_token_file_are_named_and_the_token_is_not() {
    let dir = tempfile::tempdir().unwrap();
    for (text, part) in [
        (format!("alice king {SECRET}"), "roles are worker, client and admin"),
        (format!("alice client {SECRET}\nbob client {SECRET}"), "line 2"),
        ("short-SECRET".to_owned(), "16"),
        (String::new(), "no token"),
    ] {
        std::fs::write(dir.path().join("tokens"), text).unwrap();
        let refused = run(dir.path(), "serve --listen 127.0.0.1:0 --token-file tokens");
        refused.says(2, &["tokens", part]);
        assert!(!refused.err.contains("SECRET"), "{}", refused.err);
    }
    std::fs::write(dir.path().join("two"), format!("{SECRET}1\n{SECRET}2\n")).unwrap();
    let refused = run(dir.path(), "jobs --attempts 1 --token-file two");
    refused.says(2, &["two", "exactly one token"]);
    assert!(!refused.err.contains("SECRET"), "{}", refused.err);
    run(dir.path(), "jobs --attempts 1 --coordinator https://localhost:1").says(2, &["--tls-ca"]);
}

#[test]
fn tokens_are_drawn_alone_or_as_lines_that_the_coordinator_reads() {
    let dir = tempfile::tempdir().unwrap();
    let drawn = |arguments: &str| {
        let output = run(dir.path(), arguments);
        output.says(0, &[]);
        output.out.trim().to_owned()
    };
    let (first, second) = (drawn("token"), drawn("token"));
    assert!(first != second && first.len() == 64 && first.bytes().all(|b| b.is_ascii_hexdigit()), "{first}");
    let line = drawn("token alice --role worker,client");
    assert!(line.starts_with("alice worker,client ") && line.len() == 20 + 64, "{line}");
    assert!(gatherlight::access::Tokens::parse(&format!("{line}\n{first}\n")).is_ok());
    run(dir.path(), "token alice --role king").says(2, &["--role", "worker, client and admin"]);
    run(dir.path(), "token a/b --role client").says(2, &["letters, digits"]);
    run(dir.path(), "token alice").says(2, &["--role"]);
}

#[test]
fn health_is_said_without_a_token_and_its_absence_is_a_failure() {
    let dir = tempfile::tempdir().unwrap();
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", free.local_addr().unwrap());
    drop(free);
    run(dir.path(), &format!("health --coordinator {url}")).says(1, &[&url, "not healthy"]);
}
