# The whole of CI, as the server runs it.
ci:
    .ci/run

# All tests, in the one test profile.
test:
    cargo test --workspace

# Rewrites the golden pictures and hashes; look at `git diff --stat tests/goldens demos` and at the pictures afterwards.
goldens:
    CATOPTRA_UPDATE_GOLDENS=1 cargo test -p catoptra_tests --test snapshots
    CATOPTRA_UPDATE_GOLDENS=1 cargo test -p catoptra_demos --test games
    CATOPTRA_UPDATE_GOLDENS=1 cargo test -p catoptra_demos --lib look

# The five scenes at 1024x1024 into out/.
pictures:
    cargo run --release -- render all --frame 30 --out out

# Frame times per stage of the five scenes.
bench lane="cpu":
    cargo run --release -- bench all --size 1024x1024 --frames 30 --raster {{lane}} --json out/bench-{{lane}}.json

# Licences and duplicate versions (needs cargo-deny).
deny:
    cargo deny check
