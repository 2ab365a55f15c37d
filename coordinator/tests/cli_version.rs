//! A coordinator of another version is told apart, with both versions and the address in the message.

mod common;

use common::{run, triangle_dir};
use gatherlight_proto::wire::jobs_server::{Jobs, JobsServer};
use gatherlight_proto::wire::{
    CancelRequest, Chunk, FetchImageRequest, GetRequest, GreetReply, GreetRequest, Job, ListReply, ListRequest,
    MissingReply, MissingRequest, SubmitReply, SubmitRequest, UploadReply, WatchRequest, WorkersReply, WorkersRequest,
};
use tokio::net::TcpListener;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Request, Response, Status, Streaming};

/// Speaks protocol 9999 and does nothing else.
struct FromTheFuture;

type Reply<T> = Result<Response<T>, Status>;
type Items<T> = tokio_stream::Empty<Result<T, Status>>;

fn not_reached<T>() -> Reply<T> {
    Err(Status::unimplemented("a client of another version must not come this far"))
}

#[tonic::async_trait]
impl Jobs for FromTheFuture {
    type WatchStream = Items<Job>;
    type FetchImageStream = Items<Chunk>;

    async fn greet(&self, _: Request<GreetRequest>) -> Reply<GreetReply> {
        Ok(Response::new(GreetReply { protocol: 9999, version: "77.0.0".into() }))
    }
    async fn missing(&self, _: Request<MissingRequest>) -> Reply<MissingReply> {
        not_reached()
    }
    async fn upload(&self, _: Request<Streaming<Chunk>>) -> Reply<UploadReply> {
        not_reached()
    }
    async fn submit(&self, _: Request<SubmitRequest>) -> Reply<SubmitReply> {
        not_reached()
    }
    async fn list(&self, _: Request<ListRequest>) -> Reply<ListReply> {
        not_reached()
    }
    async fn get(&self, _: Request<GetRequest>) -> Reply<Job> {
        not_reached()
    }
    async fn watch(&self, _: Request<WatchRequest>) -> Reply<Self::WatchStream> {
        not_reached()
    }
    async fn fetch_image(&self, _: Request<FetchImageRequest>) -> Reply<Self::FetchImageStream> {
        not_reached()
    }
    async fn cancel(&self, _: Request<CancelRequest>) -> Reply<Job> {
        not_reached()
    }
    async fn workers(&self, _: Request<WorkersRequest>) -> Reply<WorkersReply> {
        not_reached()
    }
}

#[test]
fn a_coordinator_of_another_version_is_refused_with_both_versions() {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let server = tonic::transport::Server::builder().add_service(JobsServer::new(FromTheFuture));
    runtime.spawn(server.serve_with_incoming(TcpListenerStream::new(listener)));
    let dir = triangle_dir();
    let parts = ["version mismatch", &url, "77.0.0", "9999", env!("CARGO_PKG_VERSION"), "same version"];
    for command in ["jobs", "workers", "submit triangle.gltf -o x.exr"] {
        run(dir.path(), &format!("{command} --coordinator {url}")).says(1, &parts);
    }
}

#[test]
fn something_that_is_no_coordinator_does_not_hang_a_client() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        use std::io::Write;
        for stream in listener.incoming().flatten() {
            let _ = { stream }.write_all(b"220 mail.example ESMTP\r\n");
        }
    });
    let dir = triangle_dir();
    run(dir.path(), &format!("jobs --coordinator {url} --attempts 2")).says(1, &[&url]);
}
