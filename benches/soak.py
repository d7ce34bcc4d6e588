#!/usr/bin/env python3
"""Memory of a training, a viewer and a study over hours.

    pip install websockets
    cape study make --data packed --poses 20 --a-pose 5 --matched 10 --trials 20 --out study
    python3 benches/soak.py cape study --minutes 120 --out soak -- \\
        table2 --data packed --rows cape --seeds 3 --out table2

Starts the command after `--`, `cape view` and `cape study serve`. Asks the viewer for pictures of sampled
codes and the study for everything that a rater's page loads, and answers as raters. Writes the resident
memory of all three to soak/memory.csv and prints how it changed after the first tenth of the time. Fails if
a request fails, a process ends early, or the memory of a server grows by more than --growth.
"""
import argparse, csv, http.client, json, pathlib, random, statistics, struct, subprocess, sys, time
import urllib.parse

from websockets.sync.client import connect

RATERS = 10_000
OUTFITS = ['shortlong', 'shortshort', 'longshort', 'longlong']


def arguments():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument('cape', help='the program')
    ap.add_argument('study', type=pathlib.Path, help='directory of `cape study make`')
    ap.add_argument('--minutes', type=float, default=120)
    ap.add_argument('--rate', type=float, default=5, help='requests to each server a second')
    ap.add_argument('--growth', type=float, default=16, help='MiB that a server may grow by')
    ap.add_argument('--out', type=pathlib.Path, default=pathlib.Path('soak'))
    ap.add_argument('command', nargs='+', help='a training, without the program')
    return ap.parse_args()


def serve(cape, *arguments):
    """A server and what it prints when it is ready."""
    process = subprocess.Popen([cape, *arguments, '--json', '--quiet'], stdout=subprocess.PIPE, text=True)
    text = ''
    while True:
        line = process.stdout.readline()
        if not line:
            sys.exit(f'{arguments}: no address: {text}')
        text += line
        if line.rstrip() in ['}', ']'] or len(text) == len(line) and line.rstrip().endswith('}'):
            return process, json.loads(text)


class Viewer:
    def __init__(self, url):
        self.url = 'ws' + url.rstrip('/')[4:] + '/socket'
        self.random = random.Random(1)
        self.socket = None
        self.requests = 0

    def __call__(self):
        # A page is opened anew now and then.
        if self.socket is None or self.requests % 500 == 0:
            if self.socket:
                self.socket.close()
            self.socket = connect(self.url, max_size=None, legacy=True)
        self.requests += 1
        outfit = self.random.choice(OUTFITS)
        code = self.ask('sample', prior='gmm', temperature=1, seed=self.requests, outfit=outfit)
        pose = [self.random.gauss(0, 0.2) for _ in range(72)]
        betas = [self.random.gauss(0, 1) for _ in range(2)]
        picture = self.ask(
            'show', z=code['z'], betas=betas, pose=pose, outfit=outfit, layers=['clothed', 'body'])
        if struct.unpack_from('<4s', picture) != (b'CAPE',):
            raise RuntimeError(f'viewer: not a picture: {picture[:80]}')

    def ask(self, question, **values):
        self.socket.send(json.dumps({'id': self.requests, question: values}))
        answer = self.socket.recv()
        if isinstance(answer, bytes):
            return answer
        answer = json.loads(answer)
        if 'error' in answer:
            raise RuntimeError(f'viewer: {answer["error"]}')
        return answer


class Study:
    def __init__(self, links):
        self.links = [urllib.parse.urlsplit(link) for link in links]
        self.random = random.Random(2)
        self.rater = -1
        self.trials = []
        self.requests = 0

    def __call__(self):
        first = self.rater
        while not self.trials:
            # Raters of an earlier run have answered all.
            if self.rater + 1 - first > len(self.links):
                sys.exit('study: all raters have answered')
            self.rater += 1
            for file in ['', 'serve.js', 'pair.js', 'study.css']:
                self.ask('GET', file)
            plan = json.loads(self.ask('GET', 'plan.json'))
            self.trials = list(enumerate(plan['trials']))[plan['next']:][::-1]
            self.ask('POST', 'event', {'kind': 'start'})
        index, trial = self.trials.pop()
        for side in ['left', 'right']:
            if not self.ask('GET', 'stimuli/' + trial[side]).startswith(b'\x89PNG'):
                raise RuntimeError(f'study: {trial[side]} is not a picture')
        side = self.random.choice(['left', 'right'])
        self.ask('POST', 'answer', {
            'index': index, 'side': side, 'rt_ms': 1200.5, 'window': [1280, 720],
            'events': [{'t': 1, 'key': 'ArrowLeft'}] * 5})

    def ask(self, method, path, body=None):
        self.requests += 1
        link = self.links[self.rater % len(self.links)]
        connection = http.client.HTTPConnection(link.netloc, timeout=60)
        headers = {'Origin': f'http://{link.netloc}', 'Content-Type': 'application/json'}
        text = None if body is None else json.dumps(body)
        connection.request(method, link.path.rstrip('/') + '/' + path, text, headers)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        if answer.status != 200:
            raise RuntimeError(f'study: {method} {path}: {answer.status}')
        return content


def resident(process):
    """Resident memory, MiB."""
    for line in pathlib.Path(f'/proc/{process.pid}/status').read_text().splitlines():
        if line.startswith('VmRSS:'):
            return int(line.split()[1]) / 1024
    return 0.0


def main():
    a = arguments()
    a.out.mkdir(parents=True, exist_ok=True)
    log = open(a.out / 'training.log', 'w')
    training = subprocess.Popen([a.cape, *a.command], stdout=log, stderr=log)
    view, scene = serve(a.cape, 'view', '--no-open', '--threads', '1')
    study, links = serve(a.cape, 'study', 'serve', str(a.study), '--raters', str(RATERS))
    processes = {'training': training, 'viewer': view, 'study': study}
    pages = [Viewer(scene['url']), Study([rater['url'] for rater in links])]
    memory = {name: [] for name in processes}
    start, next_sample = time.time(), 0.0
    try:
        with open(a.out / 'memory.csv', 'w', newline='') as file:
            table = csv.writer(file)
            table.writerow(['seconds', *processes, 'viewer requests', 'study requests'])
            while (elapsed := time.time() - start) < 60 * a.minutes:
                for page in pages:
                    page()
                ended = [name for name, process in processes.items() if process.poll() is not None]
                if [name for name in ended if name != 'training' or training.returncode]:
                    sys.exit(f'ended after {elapsed:.0f} s: {ended}')
                if elapsed >= next_sample:
                    next_sample = elapsed + 15
                    now = {name: resident(process) for name, process in processes.items()
                           if name not in ended}
                    for name, value in now.items():
                        memory[name].append(value)
                    table.writerow([f'{elapsed:.0f}', *(f'{now[name]:.1f}' if name in now else ''
                                                       for name in processes),
                                    *(page.requests for page in pages)])
                    file.flush()
                time.sleep(max(0.0, 1 / a.rate - (time.time() - start - elapsed)))
    finally:
        for process in processes.values():
            process.terminate()
    failed = False
    for name, values in memory.items():
        tenth = max(1, len(values) // 10)
        early, late = (statistics.median(part) for part in (values[tenth:2 * tenth], values[-tenth:]))
        failed |= name != 'training' and late - early > a.growth
        print(f'{name:9} {early:7.1f} MiB in the second tenth, {late:7.1f} in the last, most {max(values):7.1f}')
    for name, page in zip(['viewer', 'study'], pages):
        print(f'{name:9} {page.requests} requests')
    sys.exit(failed)


main()
