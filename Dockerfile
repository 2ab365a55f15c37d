# One build, two images:
#   docker build --target coordinator -t gatherlight .
#   docker build --target worker -t gatherlight-worker .
FROM rust:1.95-slim-bookworm AS build
WORKDIR /build
ENV CARGO_PROFILE_RELEASE_DEBUG=false CARGO_PROFILE_RELEASE_STRIP=symbols

# Dependencies are a layer of their own, rebuilt only when a manifest changes: the crates are empty here.
COPY Cargo.toml Cargo.lock ./
COPY render/Cargo.toml render/
COPY proto/Cargo.toml proto/
COPY telemetry/Cargo.toml telemetry/
COPY coordinator/Cargo.toml coordinator/
COPY worker/Cargo.toml worker/
COPY tests/Cargo.toml tests/
RUN sed -i '/^\[\[/,/^$/d' */Cargo.toml \
    && for crate in render proto telemetry coordinator worker tests; do mkdir -p $crate/src && touch $crate/src/lib.rs; done \
    && for program in coordinator/src/main worker/src/main proto/build; do echo 'fn main() {}' > $program.rs; done \
    && cargo build --release --locked --package gatherlight --package gatherlight-worker

# Cargo rebuilds what is newer than its last build, and a checkout's files may be older than the empty crates.
COPY . .
RUN find render proto telemetry coordinator worker -name '*.rs' -exec touch {} + \
    && cargo build --release --locked --package gatherlight --package gatherlight-worker --bins

FROM debian:bookworm-slim AS base
RUN useradd --system --uid 10001 --user-group --home-dir /nonexistent --shell /usr/sbin/nologin gatherlight \
    && install --directory --owner gatherlight --group gatherlight /var/lib/gatherlight

FROM base AS coordinator
COPY --from=build /build/target/release/gatherlight /usr/local/bin/
USER gatherlight
EXPOSE 7420
# Jobs, scenes and images: they survive a restart.
VOLUME /var/lib/gatherlight
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=5s --timeout=5s --start-period=30s --retries=3 \
    CMD ["gatherlight", "health"]
ENTRYPOINT ["gatherlight"]
CMD ["serve", "--listen", "0.0.0.0:7420", "--store", "/var/lib/gatherlight"]

FROM base AS worker
COPY --from=build /build/target/release/gatherlight-worker /usr/local/bin/
USER gatherlight
STOPSIGNAL SIGTERM
ENTRYPOINT ["gatherlight-worker"]
CMD ["--coordinator", "http://coordinator:7420"]
