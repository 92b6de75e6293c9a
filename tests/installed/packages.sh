# What deploy/test_packages runs in a Debian that has nothing else. In /work: the packages, examples, client/python.
set -euo pipefail
cd /work
say() { printf '%s\n' "-- $* ($SECONDS s)" >&2; }
quietly() { "$@" >log 2>&1 || { cat log >&2; say "failed: $*"; exit 1; }; }
# A mirror that is gone is nobody's mistake: 77, skipped.
apt() {
  "$@" >log 2>&1 && return
  cat log >&2
  grep -qE 'Failed to fetch|Unable to fetch' log || { say "failed: $*"; exit 1; }
  say "SKIPPED: the mirror doesn't answer"
  exit 77
}
get() { apt apt-get install -q -y --no-install-recommends "$@"; }
# Apart from what packages leave behind for their kind.
files() { find / -xdev \( -path /proc -o -path /work -o -path /tmp -o -path /var/cache -o -path /var/log -o -path /var/lib/apt \
  -o -path /var/lib/dpkg -o -path /root -o -path /etc/ld.so.cache \) -prune -o -print | sort; }
docs=/usr/share/doc/rcbd
# snippet PAGE PATTERN: the first block of code behind a line like that.
snippet() { awk -v like="$2" '$0 ~ like { near = 1 } near && /^```/ { if (open) exit; open = 1; next } open' "$docs/$1"; }
ours=$(for deb in *.deb; do echo "${deb%%_*}"; done)

apt apt-get update
say "apt install, then the first array"
begin=$SECONDS
get ./*.deb gnuplot-nox
snippet docs/install.md '^The first array' | sed -n 's/^\$ //p' >first
quietly bash -eux first
grep -q '<svg' first.svg
say "$((SECONDS - begin)) s from the packages to the first array, divided and drawn"

say "purged once, to see what is there without them"
quietly dpkg -P $ours
files >before
if grep -i rcb before; then say "left behind"; exit 1; fi

say "dpkg -i, and what is for building"
get g++ gfortran cmake make pkg-config python3-pip python3-venv
files >before
quietly dpkg -i ./*.deb

say "the README's first session"
snippet README.md '^## A first session' | sed -n 's/^\$ //p' >session
grep -q 'rcbctl up' session
quietly bash -eux session
grep -q '<svg' jet.svg

say "each language, by find_package and pkg-config"
rcbctl up -n 2 >log 2>&1
quietly cmake -S installed -B build -DEXAMPLES=$docs/examples
quietly cmake --build build
mkdir page
(
  cd page
  cp $docs/examples/c/serial.c solver.c
  cp $docs/examples/fortran/serial.f90 solver.f90
  snippet docs/install.md '^\*\*pkg-config' >commands
  grep -q gfortran commands
  while read -r command; do
    eval "$command"
    mv a.out "../build/serial_${command%% *}"
  done <commands
  { echo 'cmake_minimum_required(VERSION 3.13)' && snippet docs/install.md '^\*\*CMake'; } >CMakeLists.txt
  quietly cmake -S . -B build
  quietly cmake --build build
  for program in build/solver_?; do cp "$program" "../build/serial_page_${program: -1}"; done
)
for program in build/serial_*; do "$program" >"$program.said"; done
python3 $docs/examples/python/serial.py >build/python.said
if [[ -e python/pyproject.toml ]]; then
  quietly dpkg -P python3-rcbd
  quietly python3 -m venv --system-site-packages venv
  quietly venv/bin/pip install --no-index ./python
  venv/bin/python $docs/examples/python/serial.py >build/pip.said
  quietly dpkg -i python3-rcbd*.deb
fi
for said in build/*.said; do cmp build/serial_c.said "$said" && say "  $said"; done
rcbctl down >log 2>&1

say "purged"
quietly dpkg -P $ours
files >after
diff before after
if [[ $1 == yes ]]; then
  say "lintian"
  get lintian
  lintian --allow-root --fail-on error --tag-display-limit 0 ./*.deb
fi
