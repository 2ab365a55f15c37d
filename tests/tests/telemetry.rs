//! What the real programs tell of themselves: logs as JSON, metrics, and never a secret.

use gatherlight::client::connect_with;
use gatherlight::schedule::Policy;
use gatherlight::server::ServeConfig;
use gatherlight_proto::credentials::{Credentials, Token};
use gatherlight_tests::cluster::{
    Coordinator, PATIENCE, finished_exr, request, small_leases, small_settings, watch_until,
};
use gatherlight_tests::processes::{logged, shown_arguments};
use gatherlight_tests::scene;
use gatherlight_worker::Faults;
use serde_json::Value;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

const SECRET: &str = "whole-SECRET-0123456789";

/// All complete lines of a log, each a JSON object.
fn lines(log: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(log).unwrap_or_default();
    let complete = text.rfind('\n').map_or("", |end| &text[..end]);
    complete.lines().map(|l| serde_json::from_str(l).unwrap_or_else(|e| panic!("{e}: {l}"))).collect()
}

/// Waits for the message `text`; returns its field.
fn field(log: &Path, text: &str, name: &str) -> String {
    let begin = Instant::now();
    while begin.elapsed() < PATIENCE {
        let found = lines(log).into_iter().find(|l| l["fields"]["message"] == text);
        if let Some(value) = found.and_then(|l| l["fields"][name].as_str().map(str::to_owned)) {
            return value;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    panic!("no {text:?} in {}", log.display());
}

/// The page at `address`.
fn metrics(address: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap_or_else(|e| panic!("{address}: {e}"));
    stream.write_all(b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n").expect("is sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("is answered");
    let (head, page) = answer.split_once("\r\n\r\n").expect("is an answer");
    assert!(head.starts_with("HTTP/1.1 200"), "{head}");
    page.to_owned()
}

/// One worker sleeps over its leases, another has nothing to do and repeats them: none of them was lost.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn leases_that_are_repeated_are_none_that_were_lost() {
    let directory = tempfile::tempdir().expect("a directory");
    let policy = Policy { twin_after: Duration::from_millis(50), ..small_leases() };
    let any = "127.0.0.1:0".parse().expect("an address");
    let config =
        ServeConfig { threads: 1, policy, metrics: Some(any), ..ServeConfig::new(any, directory.path().into()) };
    let coordinator = Coordinator::start_with(config).await;
    let client = coordinator.client().await;
    let job = request(&scene("cornell-diffuse.glb"), &small_settings());
    let id = client.submit(&job, |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    let _slow = coordinator.worker("slow", Faults { delay: Duration::from_secs(1), ..Faults::default() });
    watch_until(&client, id, |p| p.workers > 0).await;
    let _quick = coordinator.worker("quick", Faults::default());
    finished_exr(&client, id).await;
    let stats = client.get(id).await.unwrap_or_else(|e| panic!("{e}")).stats;
    assert!(stats.repeated_leases > 0);
    assert_eq!(stats.retried_leases, 0);
    let page = metrics(&coordinator.metrics.expect("serves them").to_string());
    assert_eq!(value(&page, "gatherlight_leases_repeated_total"), stats.repeated_leases as f64);
    assert_eq!(value(&page, "gatherlight_leases_retried_total"), 0.0);
}

fn value(page: &str, metric: &str) -> f64 {
    let line = page.lines().find_map(|l| l.strip_prefix(metric)?.strip_prefix(' '));
    line.and_then(|v| v.parse().ok()).unwrap_or_else(|| panic!("no {metric} in\n{page}"))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn both_programs_log_json_serve_metrics_and_tell_no_secret() {
    let directory = tempfile::tempdir().expect("a directory");
    let at = |name: &str| directory.path().join(name).to_str().expect("is text").to_owned();
    std::fs::write(at("token"), SECRET).expect("is written");
    let (coordinator_log, worker_log) = (directory.path().join("c.log"), directory.path().join("w.log"));
    let common = |log: &'static str, rest: &[&str]| -> Vec<String> {
        let token = at("token");
        let fixed = ["--log", log, "--token-file", &token, "--metrics", "127.0.0.1:0", "--threads", "1"];
        rest.iter().chain(&fixed).map(|a| (*a).to_owned()).collect()
    };
    let arguments = common("json,trace", &["serve", "--listen", "127.0.0.1:0", "--store", &at("store")]);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let coordinator = logged("gatherlight", &arguments, &coordinator_log);
    let url = format!("http://{}", field(&coordinator_log, "listening", "address"));
    let arguments = common("json,trace", &["--coordinator", &url, "--name", "w"]);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let worker = logged("gatherlight-worker", &arguments, &worker_log);

    let credentials = Credentials::of_token(Token::new(SECRET).expect("is a token"));
    let client = connect_with(&url, 5, &credentials).await.unwrap_or_else(|e| panic!("{e}"));
    let job = request(&scene("cornell-diffuse.glb"), &small_settings());
    let id = client.submit(&job, |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    finished_exr(&client, id).await;
    let stranger = Credentials::of_token(Token::new("wrong-SECRET-0123456789").expect("is a token"));
    assert!(connect_with(&url, 1, &stranger).await.is_err());

    let coordinator_page =
        metrics(field(&coordinator_log, "metrics", "url").trim_start_matches("http://").trim_end_matches("/metrics"));
    assert_eq!(value(&coordinator_page, "gatherlight_jobs{state=\"done\"}"), 1.0);
    assert_eq!(value(&coordinator_page, "gatherlight_workers{state=\"idle\"}"), 1.0);
    assert_eq!(value(&coordinator_page, "gatherlight_leases_open"), 0.0);
    assert_eq!(value(&coordinator_page, "gatherlight_refusals_total{reason=\"unauthenticated\"}"), 1.0);
    let done = value(&coordinator_page, "gatherlight_leases_done_total");
    assert!(done > 0.0 && value(&coordinator_page, "process_resident_memory_bytes") > 1e6);
    assert!(value(&coordinator_page, "gatherlight_received_bytes_total") > 1e4);
    assert!(value(&coordinator_page, "gatherlight_sent_bytes_total") > 1e4);
    let worker_page = metrics(&field(&worker_log, "metrics", "address"));
    assert_eq!(value(&worker_page, "gatherlight_worker_joined"), 1.0);
    assert_eq!(value(&worker_page, "gatherlight_worker_tasks_done_total"), done);
    assert_eq!(value(&worker_page, "gatherlight_worker_tasks_failed_total"), 0.0);
    assert!(value(&worker_page, "gatherlight_worker_delivered_bytes_total") > 1e4);

    for log in [&coordinator_log, &worker_log] {
        let lines = lines(log);
        assert!(lines.iter().all(|l| ["timestamp", "level", "target"].iter().all(|k| l[k].is_string())));
    }
    let logs = [&coordinator_log, &worker_log].map(|log| std::fs::read_to_string(log).expect("is a log"));
    let shown = [shown_arguments(&coordinator), shown_arguments(&worker), coordinator_page, worker_page];
    for text in logs.iter().chain(&shown) {
        assert!(!text.contains("SECRET"), "a secret is shown: {text}");
    }
}
