#!/usr/bin/env python3
"""Times `cape eval speed` and PyTorch implementations of CAPE in turn and prints the ratios.

    cargo build --release --workspace --bins --benches
    python3 benches/peers.py --peers DIR --python PYTHON [--rounds 3] [--threads 2]

DIR holds `cape_torch.py` (commands `train-step`, `decode` and `encode` with `--impl smart|expert`)
and `smplx_speed.py`; PYTHON is an interpreter with torch, numpy, scipy and smplx. Everything runs
in turn, round by round, so that a machine whose speed drifts slows all of it; ratios are of medians.
"""
import argparse, json, pathlib, re, statistics, subprocess

ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
ap.add_argument('--peers', required=True, type=pathlib.Path)
ap.add_argument('--python', required=True)
ap.add_argument('--cape', default='target/release/cape')
ap.add_argument('--rounds', type=int, default=3)
ap.add_argument('--threads', type=int, default=2)
a = ap.parse_args()


def run(*command):
    return subprocess.run([str(c) for c in command], check=True, capture_output=True, text=True).stdout


def ours(threads):
    return json.loads(run(a.cape, 'eval', 'speed', '--json', '--threads', threads))


def peer(work, implementation, batch, threads):
    """Seconds and peak memory in MB."""
    out = run(a.python, '-B', a.peers / 'cape_torch.py', work, '--impl', implementation, '--batch', batch,
              '--threads', threads, '--onednn', '--malloc', '--reps', 5, '--timeout', 60)
    line = out.strip().splitlines()[-1]
    seconds = float(re.search(r': ([0-9.e+-]+) s ', line).group(1))
    return seconds, float(re.search(r'peak RSS ([0-9.]+) GB', line).group(1)) * 1000


def criterion(bench, name):
    """Milliseconds of each of a bench's functions, compiled before."""
    out = run('cargo', 'bench', '--quiet', '--workspace', '--bench', bench, '--', name)
    scale = {'ns': 1e-6, 'µs': 1e-3, 'ms': 1, 's': 1e3}
    return {name: float(value) * scale[unit] for name, value, unit in
            re.findall(r'^(\S.*?)\s+time:\s+\[\S+ \S+ (\S+) (\S+) ', out, re.M)}


samples = {}


def note(name, value):
    samples.setdefault(name, []).append(value)


for _ in range(a.rounds):
    result = ours(a.threads)
    for key in ('seconds_per_update', 'decode_ms_batch1', 'decode_ms_batch16', 'encode_ms_batch16',
                'peak_rss_mb', 'gflops', 'peak_fraction'):
        note(key, result[key])
    for implementation in ('smart', 'expert'):
        seconds, memory = peer('train-step', implementation, 16, a.threads)
        note(f'update {implementation}', seconds)
        note(f'memory {implementation}', memory)
    for work, batch in (('decode', 16), ('decode', 1), ('encode', 16)):
        note(f'{work} {batch} smart', 1e3 * peer(work, 'smart', batch, a.threads)[0])
    if a.threads > 1:
        note('one thread', ours(1)['seconds_per_update'])
        note('one thread smart', peer('train-step', 'smart', 16, 1)[0])

median = {name: statistics.median(values) for name, values in samples.items()}
rows = [('update, against smart', 'seconds_per_update', 'update smart', 's', 0.75),
        ('update, against expert', 'seconds_per_update', 'update expert', 's', 0.5),
        ('update, one thread', 'one thread', 'one thread smart', 's', 0.9),
        ('decode, batch 16', 'decode_ms_batch16', 'decode 16 smart', 'ms', 0.8),
        ('decode, batch 1', 'decode_ms_batch1', 'decode 1 smart', 'ms', 0.8),
        ('encode, batch 16', 'encode_ms_batch16', 'encode 16 smart', 'ms', 0.9),
        ('peak memory of training', 'peak_rss_mb', 'memory smart', 'MB', 0.5)]
print(f'| {a.threads} threads, {a.rounds} rounds | ours | peer | ratio | goal |\n|---|---|---|---|---|')
for name, mine, theirs, unit, goal in rows:
    if mine in median and theirs in median:
        print(f'| {name} | {median[mine]:.4g} {unit} | {median[theirs]:.4g} {unit} | '
              f'{median[mine] / median[theirs]:.2f} | {goal} |')
print(f"\n{median['gflops']:.0f} GFLOP/s, {100 * median['peak_fraction']:.0f} % of the peak")

theirs = {batch: float(ms) for batch, ms in re.findall(
    r'batch (\d+): ([0-9.]+) ms', run(a.python, '-B', a.peers / 'smplx_speed.py', a.threads))}
print('\n| SMPL | ours | smplx | ratio | goal |\n|---|---|---|---|---|')
for name, ms in criterion('smpl', 'weights, batch').items():
    batch = name.split()[-1]
    print(f'| {name} | {ms:.3g} ms | {theirs[batch]:.4g} ms | {ms / theirs[batch]:.2f} | 0.33 |')
print('\n| pyramid | ours | goal |\n|---|---|---|')
for name, ms in criterion('graph', 'pyramid').items():
    print(f'| {name} | {ms:.3g} ms | 100 ms |')
