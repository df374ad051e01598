#!/bin/sh
# Installs this bundle on the robot that it was made for. `sh install.sh --help` says how; running it again is harmless.
set -eu
umask 022

usage() {
    cat <<'TEXT'
usage: sh install.sh [--prefix DIR] [--no-systemd] [--no-restart] [--dry-run]

Installs this bundle, without internet, into DIR/releases/<id> and then points DIR/current at it, in one step:
what is interrupted before that has changed nothing that is in use. A second run finds nothing to do and says so.

  --prefix DIR   where to install (default /opt/formation)
  --no-systemd   no user, no units: only the files (needs no root)
  --no-restart   install the units, but leave running ones as they are
  --dry-run      say what would be done, and do nothing

The three releases used last are kept; DIR/previous is the one before DIR/current.
To uninstall: systemctl disable --now formation-agent formation-watchdog formation-leader formation-standby
              rm /etc/systemd/system/formation-*.service; systemctl daemon-reload
              rm -r DIR /var/lib/formation; userdel formation
TEXT
}

say() { printf 'formation: %s\n' "$*"; }
refuse() { printf 'formation: %s\n' "$*" >&2; exit 2; }
failed() { printf 'formation: %s\n' "$*" >&2; exit 1; }

prefix=/opt/formation systemd=yes restart=yes dry=no
while [ $# -gt 0 ]; do
    case $1 in
        --prefix) [ $# -ge 2 ] || refuse "--prefix needs a folder"; prefix=$2; shift ;;
        --prefix=*) prefix=${1#--prefix=} ;;
        --no-systemd) systemd=no ;;
        --no-restart) restart=no ;;
        --dry-run) dry=yes ;;
        -h | --help) usage; exit 0 ;;
        *) refuse "$1: unknown; legal are --prefix DIR, --no-systemd, --no-restart and --dry-run" ;;
    esac
    shift
done
case $prefix in /*) ;; *) prefix=$(pwd)/$prefix ;; esac
prefix=${prefix%/}
case $prefix in
    '' | *[!A-Za-z0-9_./+-]*) refuse "--prefix $prefix: must be a folder named with letters, digits and . _ + - only" ;;
esac

bundle=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
for part in VERSION.json mission.toml zenoh.json5 units wheels/requirements.txt \
    certificates/ca.pem certificates/certificate.pem certificates/key.pem; do
    [ -e "$bundle/$part" ] || refuse "$bundle holds no $part: it is not a whole bundle"
done
fact() { sed -n "s/^ *\"$1\": \"\{0,1\}\([^\",]*\)\"\{0,1\},\{0,1\}\$/\1/p" "${2:-$bundle}/VERSION.json"; }
release=$(fact release) robot=$(fact robot) role=$(fact role) mission=$(fact mission)
platform=$(fact platform) wanted=$(fact python) wheels=$(fact wheels) bringup=$(fact bringup)
for found in "$release" "$robot" "$platform" "$wanted"; do
    [ -n "$found" ] || refuse "$bundle/VERSION.json cannot be read: make the bundle again"
done
home=$prefix/releases/$release
[ "$(sha256sum <"$bundle/mission.toml" | cut -c1-64)" = "$(fact mission_sha256)" ] ||
    refuse "$bundle/mission.toml was changed after the bundles were made, for this robot only: make the bundles again"

# Does it fit this machine?
machine=$(uname -m)
[ "$machine" = "$platform" ] || refuse "this bundle is for $platform, and this machine is $machine: make one with --platform $machine"
python=
for candidate in "python$wanted" python3 python; do
    if found=$(command -v "$candidate") &&
        [ "$("$found" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)" = "$wanted" ]; then
        python=$found
        break
    fi
done
here=$(python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null || echo none)
[ -n "$python" ] || refuse "this bundle is for Python $wanted, and here is Python $here: install python$wanted, or make a bundle with --python"
unfit=$("$python" -c '
import os, platform, struct, sys
try:
    import venv
except ImportError:
    sys.exit("its venv module is missing: install the package libpython3-stdlib or python3-venv")
name, version = platform.libc_ver()
if struct.calcsize("P") != 8:
    sys.exit("it is a 32-bit one: install a 64-bit system")
if name != "glibc" or tuple(map(int, version.split("."))) < (2, 28):
    sys.exit("it runs on %s %s, and the wheels need glibc 2.28 or newer" % (name or "another C library", version))
' 2>&1) || refuse "$python does not fit: $unfit"
if [ "$systemd" = yes ]; then
    case $("$python" -c 'import os, sys; print(os.path.realpath(sys.executable))') in
        /home/* | /root/*) refuse "$python lies in a user's home, which services do not see: install the system's python$wanted" ;;
    esac
fi

# What is there already?
whole() { [ -f "$1/VERSION.json" ] && [ -x "$1/venv/bin/python" ]; }
configuration="mission.toml zenoh.json5 certificates/ca.pem certificates/certificate.pem certificates/key.pem"
text() { # a file of the bundle as this robot gets it
    case $1 in
        zenoh.json5 | units/*) sed "s|@PREFIX@|$prefix|g" "$bundle/$1" ;;
        *) cat "$bundle/$1" ;;
    esac
}
put() { # a file into the release, in one step; keys are readable by their owner only, from the first byte on
    rm -f "$home/$1.new"
    case $1 in
        certificates/*) (umask 077 && text "$1" >"$home/$1.new") ;;
        *) text "$1" >"$home/$1.new" ;;
    esac && mv "$home/$1.new" "$home/$1"
}
differing=
if whole "$home"; then
    for part in $configuration; do
        # not every user of --dry-run may read keys
        case $part in certificates/*) [ ! -d "$home/certificates" ] || [ -x "$home/certificates" ] || continue ;; esac
        text "$part" | cmp -s - "$home/$part" || differing="$differing $part"
    done
fi
current=$(readlink "$prefix/current" 2>/dev/null || true)
current=${current##*/}
unfinished=$prefix/.unfinished # there from the switch to a release until its units have been started
units=/etc/systemd/system
unit_is_new() { ! [ -f "$units/$1" ] || ! text "units/$1" | cmp -s - "$units/$1"; }
new_units=
if [ "$systemd" = yes ]; then
    for unit in "$bundle"/units/*.service; do
        unit_is_new "${unit##*/}" && new_units="$new_units ${unit##*/}"
    done
fi
other_units= # this prefix's own, of another role that this machine had before
if [ "$systemd" = yes ] && [ "$restart" = yes ]; then
    for unit in formation-agent.service formation-watchdog.service formation-leader.service formation-standby.service; do
        if ! [ -e "$bundle/units/$unit" ] && grep -q "^ExecStart=$prefix/current/" "$units/$unit" 2>/dev/null; then
            other_units="$other_units $unit"
        fi
    done
fi
pending=
if [ "$systemd" = yes ] && [ -e "$unfinished" ]; then pending=yes; fi
if [ "$current" = "$release" ] && whole "$home" && [ -z "$new_units$other_units$pending$differing" ]; then
    say "$robot runs release $release of $mission from $prefix already: nothing to do"
    exit 0
fi
if [ "$dry" = yes ]; then
    whole "$home" || say "would install release $release into $home, with $python"
    [ -z "$differing" ] || say "would restore$differing in $home, changed since the installation"
    [ "$current" = "$release" ] || say "would point $prefix/current at it (now ${current:-nothing})"
    [ -z "$new_units" ] || say "would install the units$new_units into $units"
    [ -z "$other_units" ] || say "would end and remove$other_units: this machine is no longer that"
    [ -z "$pending" ] || say "would start the units: an earlier installation did not come to that"
    exit 0
fi
if [ "$systemd" = yes ]; then
    [ "$(id -u)" = 0 ] || refuse "must be run as root (sudo sh install.sh), or with --no-systemd"
    command -v systemctl >/dev/null || refuse "there is no systemd here: use --no-systemd and start the processes yourself"
fi

mkdir -p "$prefix/releases" || failed "$prefix cannot be made"
if command -v flock >/dev/null; then
    exec 9>"$prefix/.install.lock"
    flock -n 9 || refuse "another installation is running into $prefix just now"
fi
trap 'failed "interrupted; $prefix/current is what it was"' INT TERM HUP

owner=
if [ "$systemd" = yes ]; then
    owner=formation
    if ! id "$owner" >/dev/null 2>&1; then
        useradd --system --user-group --no-create-home --home-dir /nonexistent --shell /usr/sbin/nologin "$owner" ||
            failed "the user $owner cannot be made"
    fi
fi

if ! whole "$home"; then
    free=$(df -Pk "$prefix" | awk 'NR == 2 { print $4 }')
    [ "$free" -ge 200000 ] || refuse "$prefix has only $((free / 1000)) MB free, and a release needs 200"
    begin=$(date +%s)
    say "installing release $release for $robot into $home (up to some minutes)"
    rm -rf "$home" # what an interrupted installation left
    mkdir -p "$home/units"
    "$python" -m venv --without-pip "$home/venv" || failed "no virtual environment can be made in $home"
    set -- --find-links "$bundle/wheels" --requirement "$bundle/wheels/requirements.txt"
    # Where packages are fetched from is for this machine's pip configuration to say; else that has no say.
    [ "$wheels" = false ] || set -- --isolated --no-index "$@"
    # The bundle's own pip, run from its wheel: the robot needs none. Nothing but what the list names, as it hashes.
    (
        unset PYTHONPATH PYTHONHOME
        exec "$home/venv/bin/python" "$(echo "$bundle"/wheels/pip-*.whl)/pip" install \
            --disable-pip-version-check --no-input --quiet --no-cache-dir --no-warn-script-location --root-user-action ignore \
            --require-hashes --no-deps --only-binary :all: "$@"
    ) || failed "the packages cannot be installed; $prefix/current is what it was"

    (umask 077 && mkdir "$home/certificates")
    for part in $configuration; do put "$part"; done
    for unit in "$bundle"/units/*.service; do put "units/${unit##*/}"; done
    [ -z "$owner" ] || chown -R "$owner:$owner" "$home/certificates"

    "$home/venv/bin/python" -I -c '
import sys, numpy, pydantic, zenoh
from formation.control.laws import why_unusable
from formation.mission.file import load
mission = load(sys.argv[1])
known = [*mission.robots, *mission.standbys]
sys.exit(why_unusable(mission.law.kind) if sys.argv[2] in known else "the mission has no robot %s" % sys.argv[2])
' "$home/mission.toml" "$robot" || failed "what was installed does not run here; $prefix/current is what it was"

    cp "$bundle/VERSION.json" "$home/.VERSION.json"
    chmod 644 "$home/.VERSION.json"
    sync -f "$home" 2>/dev/null || sync # a robot is switched off by its switch
    mv "$home/.VERSION.json" "$home/VERSION.json" # last of all: a release without it is not whole
    say "installed in $(($(date +%s) - begin)) s"
elif [ -n "$differing" ]; then
    [ "$systemd" = no ] || : >"$unfinished"
    (umask 077 && mkdir -p "$home/certificates")
    for part in $differing; do put "$part"; done
    [ -z "$owner" ] || chown -R "$owner:$owner" "$home/certificates"
    say "restored in release $release, where it had been changed:$differing"
fi

point() { # a link that names its new target from one moment to the next
    rm -f "$prefix/.$1.new"
    ln -s "releases/$2" "$prefix/.$1.new"
    mv -T "$prefix/.$1.new" "$prefix/$1"
}
[ "$systemd" = no ] || : >"$unfinished"
if [ "$current" != "$release" ]; then
    if [ -n "$current" ] && whole "$prefix/releases/$current"; then point previous "$current"; fi
    touch "$home"
    point current "$release"
    trap - INT TERM HUP
    say "$prefix/current is release $release${current:+ (was $current)}"
    was=
    if [ -n "$current" ] && whole "$prefix/releases/$current"; then was=$(fact robot "$prefix/releases/$current"); fi
    [ "${was:-$robot}" = "$robot" ] || say "NOTE: this machine was $was, and is $robot now; is that the right folder?"
fi

if [ "$systemd" = yes ]; then
    names=
    for unit in "$bundle"/units/*.service; do
        name=${unit##*/}
        names="$names $name"
        if unit_is_new "$name"; then
            text "units/$name" >"$units/.$name.new"
            chmod 644 "$units/.$name.new"
            mv "$units/.$name.new" "$units/$name"
        fi
    done
    if [ -n "$other_units" ]; then
        # shellcheck disable=SC2086 # they are words
        systemctl --quiet disable --now $other_units || failed "the units of an earlier role do not end:$other_units"
        for name in $other_units; do rm -f "$units/$name"; done
        say "ended and removed$other_units: this machine is no longer that"
    fi
    systemctl daemon-reload
    # shellcheck disable=SC2086 # they are words
    systemctl --quiet enable $names || failed "the units cannot be enabled"
    if [ "$restart" = no ]; then
        say "running services were left alone; they change with: systemctl restart$names"
    elif [ "$role" = agent ] && [ -n "$bringup" ] && ! systemctl --quiet is-active "$bringup"; then
        systemctl restart formation-watchdog.service || failed "installed, but not started; see: journalctl -u formation-watchdog"
        say "formation-agent starts with $bringup, which does not run now (samples are in $bundle/samples)"
    else
        # shellcheck disable=SC2086 # they are words
        systemctl restart $names || failed "installed, but not started; see: journalctl -u formation-$role"
        say "started:$names"
    fi
    rm -f "$unfinished"
fi

# The three used last are kept, those that the links name among them; and those that run.
before=$(readlink "$prefix/previous" 2>/dev/null || true)
before=${before##*/}
kept=1
[ -z "$before" ] || kept=2
# shellcheck disable=SC2045 # their names are ours: hexadecimal
for name in $(ls -1t "$prefix/releases"); do
    case $name in "$release" | "$before") continue ;; esac
    # not from under a process that has not been started again since (--no-restart)
    if grep -qsF "$prefix/releases/$name/" /proc/[0-9]*/maps; then continue; fi
    if [ "$kept" -lt 3 ] && whole "$prefix/releases/$name"; then
        kept=$((kept + 1))
    else
        rm -rf "${prefix:?}/releases/$name"
    fi
done
