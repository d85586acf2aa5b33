# bsk_torch with compiled kernels, for CPUs.
#   docker build -t bsk_torch .        the kernels are built for this machine's instructions; --build-arg ISA=avx2 for older ones
#   docker run --rm -v "$PWD/runs:/runs" bsk_torch train NadirScan-v1 --minutes 3 --out /runs/scan
FROM python:3.11-slim-bookworm AS build
RUN apt-get update && apt-get install --no-install-recommends -y g++=4:12.* && rm -rf /var/lib/apt/lists/*
RUN python -m venv /opt/venv
ENV PATH=/opt/venv/bin:$PATH
WORKDIR /src
COPY . .
RUN pip install --no-cache-dir --index-url https://download.pytorch.org/whl/cpu torch==2.13.0 \
    && pip install --no-cache-dir -c constraints.txt ".[viz]"
ARG ISA=
RUN bsk-torch build-kernels --out /opt/kernels ${ISA:+--isa "$ISA"}

FROM python:3.11-slim-bookworm
COPY --from=build /opt/venv /opt/venv
COPY --from=build /opt/kernels /opt/kernels
ENV PATH=/opt/venv/bin:$PATH BSK_TORCH_KERNELS=/opt/kernels
RUN useradd --create-home --uid 1000 user
USER 1000
WORKDIR /home/user
ENTRYPOINT ["bsk-torch"]
