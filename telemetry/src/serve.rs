//! Metrics over HTTP/1: `GET /metrics`, and nothing else.

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{CONTENT_TYPE, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use std::convert::Infallible;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;

/// Readers at once; more wait.
const MAX_READERS: usize = 16;
/// Time a reader has for one question and its answer.
const PATIENCE: Duration = Duration::from_secs(10);
/// Longest headers of a question, together.
const MAX_HEADER_BYTES: usize = 16 << 10;
/// Pause after the system refused a connection.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// What Prometheus expects.
const TEXT: HeaderValue = HeaderValue::from_static("text/plain; version=0.0.4; charset=utf-8");

/// Makes a page of metrics.
pub type MakePage = Arc<dyn Fn() -> Pin<Box<dyn Future<Output = String> + Send>> + Send + Sync>;

/// Serves the pages that `make` makes, until it is dropped.
pub async fn serve(listener: TcpListener, make: MakePage) {
    let readers = Arc::new(Semaphore::new(MAX_READERS));
    loop {
        let Ok(turn) = readers.clone().acquire_owned().await else { return };
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!(%error, "a reader of metrics could not be taken");
                tokio::time::sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        let make = make.clone();
        tokio::spawn(async move {
            let service = service_fn(move |request: Request<Incoming>| answer(make.clone(), request));
            let connection = http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(PATIENCE)
                .max_buf_size(MAX_HEADER_BYTES)
                .keep_alive(false)
                .serve_connection(TokioIo::new(stream), service);
            // A reader that breaks off harms itself only.
            drop(tokio::time::timeout(PATIENCE, connection).await);
            drop(turn);
        });
    }
}

async fn answer(make: MakePage, request: Request<Incoming>) -> Result<Response<Full<Bytes>>, Infallible> {
    let (status, text) = match (request.method(), request.uri().path()) {
        (&Method::GET, "/metrics") => (StatusCode::OK, make().await),
        (&Method::GET, _) => (StatusCode::NOT_FOUND, "metrics are at /metrics\n".into()),
        _ => (StatusCode::METHOD_NOT_ALLOWED, "GET only\n".into()),
    };
    let mut response = Response::new(Full::from(text));
    *response.status_mut() = status;
    response.headers_mut().insert(CONTENT_TYPE, TEXT);
    Ok(response)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpStream;

    async fn asked(question: &str) -> String {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        let make: MakePage = Arc::new(|| Box::pin(async { "x 1\n".to_owned() }));
        let serving = tokio::spawn(serve(listener, make));
        let mut stream = TcpStream::connect(address).await.expect("connects");
        stream.write_all(question.as_bytes()).await.expect("is sent");
        let mut answer = String::new();
        drop(stream.read_to_string(&mut answer).await);
        serving.abort();
        answer
    }

    #[tokio::test]
    async fn the_page_is_served_and_nothing_else() {
        let page = asked("GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n").await;
        assert!(page.starts_with("HTTP/1.1 200") && page.ends_with("\r\n\r\nx 1\n"), "{page}");
        assert!(page.contains("text/plain; version=0.0.4"), "{page}");
        assert!(asked("GET /etc/passwd HTTP/1.1\r\nHost: x\r\n\r\n").await.starts_with("HTTP/1.1 404"));
        assert!(
            asked("POST /metrics HTTP/1.1\r\nHost: x\r\nContent-Length: 0\r\n\r\n").await.starts_with("HTTP/1.1 405")
        );
        assert!(asked("nonsense\r\n\r\n").await.starts_with("HTTP/1.1 400"));
    }
}
