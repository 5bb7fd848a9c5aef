# Debian 12 with the packages built: docker build -t xray_tracking . && docker run --rm xray_tracking
FROM debian:12
SHELL ["/bin/bash", "-euo", "pipefail", "-c"]
WORKDIR /xray_tracking
COPY scripts scripts
RUN . scripts/common.sh; install_dependencies; rm -rf /var/lib/apt/lists/*
COPY . .
RUN . scripts/common.sh; build_workspace
CMD ["scripts/run", "--headless"]
