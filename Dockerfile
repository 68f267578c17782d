# RenderFlow in a container: `docker build -t renderflow .`, then `docker run --rm -v "$PWD:/work" renderflow render --seed 7 -o out`.
# tests/container/run.sh follows this file line by line in a chroot.
FROM rust:1.95-bookworm AS build
RUN apt-get update && apt-get install -y --no-install-recommends python3 python3-pip && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
RUN sh scripts/fetch_oidn.sh
RUN cargo build --release --locked

FROM debian:bookworm-slim
COPY --from=build /source/target/release/renderflow /opt/renderflow/renderflow
COPY --from=build /source/.oidn/pyoidn/oidn/lib /opt/renderflow/lib
RUN ln -s /opt/renderflow/renderflow /usr/local/bin/renderflow
WORKDIR /work
ENTRYPOINT ["renderflow"]
CMD ["--help"]
