# drsplat on a CPU, without models:   docker run --rm drsplat demo
#   docker build -t drsplat -f containers/cpu.Dockerfile .
#   docker run --rm -v "$PWD:/data" drsplat locate scene.field "red mug" --vocabulary clip_texts.json
#   docker run --rm -p 127.0.0.1:8765:8765 -v "$PWD:/data:ro" drsplat serve scenes --host 0.0.0.0 --api-key-file key
FROM python:3.12-slim-bookworm AS build
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends g++ && rm -rf /var/lib/apt/lists/*
COPY . /source
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels /source

FROM python:3.12-slim-bookworm
ARG EXTRAS=viewer,serve,mcp
RUN --mount=type=bind,from=build,source=/wheels,target=/wheels \
    pip install --no-cache-dir "$(echo /wheels/drsplat-*.whl)[$EXTRAS]" \
    && useradd --create-home --uid 1000 drsplat \
    && mkdir /data && chown drsplat /data
USER 1000
WORKDIR /data
ENTRYPOINT ["drsplat"]
CMD ["--help"]
