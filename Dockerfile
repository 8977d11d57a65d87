# tai, built from this checkout, in two stages: the second one has no compiler and no LLVM.
#   docker build -t tai . && docker run --rm tai python3 -m tai doctor
FROM debian:12 AS build
RUN apt-get update \
 && apt-get install -y --no-install-recommends git make sudo ca-certificates python3-venv \
 && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY . .
RUN make wheel

FROM debian:12-slim
RUN apt-get update \
 && apt-get install -y --no-install-recommends python3 python3-venv libstdc++6 \
 && rm -rf /var/lib/apt/lists/*
COPY --from=build /src/dist/*-cp311-*.whl /tmp/
RUN python3 -m venv /opt/tai && /opt/tai/bin/pip install --no-cache-dir /tmp/*.whl && rm /tmp/*.whl
ENV PATH=/opt/tai/bin:$PATH
CMD ["python", "-m", "tai", "doctor"]
