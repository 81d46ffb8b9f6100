# drsplat with SAM, CLIP and training on a CUDA GPU:   docker run --rm --gpus all drsplat-cuda doctor
#   docker build -t drsplat-cuda -f containers/cuda.Dockerfile .
# CUDA's libraries come with the packages; the kernels are compiled when they are first used. Keep them, and the models,
# in a volume:
#   docker run --rm --gpus all -v "$PWD:/data" -v drsplat-cache:/home/drsplat drsplat-cuda train capture --device cuda
FROM ubuntu:24.04
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends g++ python3 python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/*
ENV PATH=/opt/drsplat/bin:$PATH NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility
ARG EXTRAS=models,cuda,viewer,serve,mcp
COPY . /source
RUN python3 -m venv /opt/drsplat \
    && pip install --no-cache-dir "/source[$EXTRAS]" \
    && rm -rf /source \
    && userdel --remove ubuntu \
    && useradd --create-home --uid 1000 drsplat \
    && mkdir /data && chown drsplat /data
USER 1000
WORKDIR /data
ENTRYPOINT ["drsplat"]
CMD ["--help"]
