//! Blobs go in whole or not at all.

use super::{Store, StoreError};
use bytes::Bytes;
use gatherlight_proto::chunk::chunks;
use gatherlight_proto::{Digest, WireError};
use std::sync::Arc;

fn blob(len: usize) -> Bytes {
    (0..len).map(|i| (i % 251) as u8).collect::<Vec<_>>().into()
}

fn upload(store: &Arc<Store>, bytes: &Bytes, digest: Digest) -> Result<(), StoreError> {
    let mut upload = store.upload();
    for chunk in chunks(bytes.clone(), digest) {
        upload.push(&chunk)?;
    }
    upload.finish().map(drop)
}

fn on_disk(limit: u64) -> (tempfile::TempDir, Arc<Store>) {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let store = Arc::new(Store::open(directory.path(), limit).expect("opens"));
    (directory, store)
}

#[test]
fn blobs_come_back_from_memory_and_disk() {
    let (_guard, disk) = on_disk(1 << 30);
    for store in [Arc::new(Store::memory()), disk] {
        let bytes = blob(5_000_000);
        let digest = Digest::of(&bytes);
        assert!(!store.contains(digest) && store.get(digest).is_err() && store.read_at(digest, 0).is_err());
        upload(&store, &bytes, digest).expect("uploads");
        upload(&store, &bytes, digest).expect("uploads again");
        assert!(store.contains(digest));
        assert_eq!(store.get(digest).expect("is there"), bytes);
        assert_eq!(store.len(digest).expect("is there"), bytes.len() as u64);
        assert_eq!(store.read_at(digest, 4_999_990).expect("is there"), bytes.slice(4_999_990..));
        assert!(store.read_at(digest, 6_000_000).expect("is there").is_empty());
        assert_eq!(store.put(bytes.clone()).expect("is there").digest, digest);
        assert_eq!(store.used_bytes.load(std::sync::atomic::Ordering::Relaxed), 5_000_000);
    }
}

#[test]
fn a_damaged_upload_leaves_nothing() {
    let (directory, store) = on_disk(1 << 30);
    let bytes = blob(3_000_000);
    let claimed = Digest::of(b"something else");
    assert!(matches!(upload(&store, &bytes, claimed), Err(StoreError::Wire(WireError::Digest { .. }))));
    let mut half = store.upload();
    half.push(&chunks(bytes.clone(), Digest::of(&bytes)).next().expect("a chunk")).expect("is fine");
    drop(half);
    assert!(!store.contains(claimed) && !store.contains(Digest::of(&bytes)));
    let left = std::fs::read_dir(directory.path().join("partial")).expect("is there").count();
    assert_eq!((left, store.used_bytes.load(std::sync::atomic::Ordering::Relaxed)), (0, 0));
}

#[test]
fn a_full_store_says_so_and_how_to_raise_the_limit() {
    let (_guard, store) = on_disk(1_000);
    let bytes = blob(1_001);
    let error = upload(&store, &bytes, Digest::of(&bytes)).expect_err("is full").to_string();
    assert!(error.contains("1000") && error.contains("--max-store"), "{error}");
    let bytes = blob(1_000);
    upload(&store, &bytes, Digest::of(&bytes)).expect("just fits");
}

#[test]
fn the_same_blob_uploaded_twice_at_once_counts_once() {
    let (_guard, store) = on_disk(1 << 30);
    let bytes = blob(100_000);
    let begin = || {
        let mut upload = store.upload();
        chunks(bytes.clone(), Digest::of(&bytes)).for_each(|c| upload.push(&c).expect("is fine"));
        upload
    };
    let (first, second) = (begin(), begin());
    first.finish().expect("stores");
    second.finish().expect("is there already");
    assert_eq!(store.used_bytes.load(std::sync::atomic::Ordering::Relaxed), 100_000);
}

#[test]
fn a_reopened_store_knows_its_blobs_and_finds_damage() {
    let (directory, store) = on_disk(1 << 30);
    let bytes = blob(10_000);
    let digest = store.put(bytes.clone()).expect("stores").digest;
    std::fs::write(directory.path().join("partial/7"), b"rest").expect("writes");
    assert!(Store::open(directory.path(), 1 << 30).is_err(), "two coordinators at once");
    drop(store);
    let again = Store::open(directory.path(), 1 << 30).expect("opens");
    assert_eq!(again.get(digest).expect("is there"), bytes);
    assert_eq!(again.used_bytes.load(std::sync::atomic::Ordering::Relaxed), 10_000);
    std::fs::write(directory.path().join("blobs").join(digest.to_string()), b"flipped").expect("writes");
    assert!(again.get(digest).expect_err("is damaged").to_string().contains("damaged"));
}

#[test]
fn a_store_that_is_no_directory_is_an_error() {
    let file = tempfile::NamedTempFile::new().expect("a file");
    assert!(Store::open(file.path(), 1).is_err());
}
