# Two stages: the build needs a C compiler (SQLite is compiled in), the result needs only the C library.
FROM rust:1.95-slim-bookworm AS build
WORKDIR /union3d
COPY Cargo.toml Cargo.lock ./
COPY proto proto
COPY src src
COPY deploy/page/dist deploy/page/dist
# Only for the manifests of the other members of the workspace.
COPY tests tests
COPY deploy/python deploy/python
RUN cargo build --release --locked --bin union3d \
    && mkdir --mode=700 /data

FROM gcr.io/distroless/cc-debian12:nonroot
COPY --from=build /union3d/target/release/union3d /usr/local/bin/union3d
COPY deploy/LICENSE-MIT deploy/LICENSE-APACHE /usr/share/doc/union3d/
# The user of this image (65532) owns the data directory, so that a fresh volume is writable.
COPY --from=build --chown=65532:65532 /data /data
USER 65532:65532
VOLUME /data
EXPOSE 7373 7374
STOPSIGNAL SIGTERM
# Inside a container loopback is the container's own, so it listens on every address. That wants keys and TLS (mount them, and name
# them by UNION3D_KEYS and the settings of TLS), or UNION3D_INSECURE=true where the published ports keep strangers out.
ENTRYPOINT ["/usr/local/bin/union3d"]
CMD ["serve", "--http", "0.0.0.0:7373", "--grpc", "0.0.0.0:7374", "--data", "/data"]
