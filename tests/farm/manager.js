// What Flamenco's manager offers a job compiler script (internal/manager/job_compilers), for `flamenco.py`:
// node manager.js SCRIPT < {"name": ..., "settings": {...}} > {"type": JOB_TYPE, "tasks": [...]}

const fs = require("fs");
const paths = require("path").posix;
const vm = require("vm");

function explode(range) {
    const frames = new Set();
    for (const part of range.replaceAll("..", "-").split(",")) {
        const ends = part.split("-").map((end) => end.trim());
        if (ends.length > 2 || !ends.every((end) => /^\d+$/.test(end))) {
            throw new Error(`invalid range "${range}": ${part}`);
        }
        for (let frame = Number(ends[0]); frame <= Number(ends[ends.length - 1]); frame++) {
            frames.add(frame);
        }
    }
    return [...frames].sort((a, b) => a - b);
}

function merge(frames) {
    const runs = [];
    for (const frame of frames) {
        const last = runs[runs.length - 1];
        if (last && last[1] + 1 == frame) {
            last[1] = frame;
        } else {
            runs.push([frame, frame]);
        }
    }
    // two frames in a row are no range
    return runs.map(([a, b]) => (a == b ? `${a}` : a + 1 == b ? `${a},${b}` : `${a}-${b}`)).join(",");
}

function frameChunker(range, size) {
    if (!(size >= 1)) {
        throw new Error(`invalid chunk size, must be positive number: ${size}`);
    }
    const frames = explode(range);
    const chunks = [];
    for (let at = 0; at < frames.length; at += size) {
        chunks.push(merge(frames.slice(at, at + size)));
    }
    return chunks;
}

function shellSplit(text) {
    const words = text.match(/(?:[^\s'"]|'[^']*'|"[^"]*")+/g) || [];
    return words.map((word) => word.replace(/'([^']*)'|"([^"]*)"/g, "$1$2"));
}

let count = 0;
const author = {
    Task(name, type) {
        const task = { id: ++count, name: name.trim(), type: type.trim(), commands: [], needs: [] };
        task.addCommand = (command) => task.commands.push(structuredClone(command));
        task.addDependency = (other) => task.needs.push(other.id);
        return task;
    },
    Command(name, parameters, steps) {
        return { name: name, parameters: parameters, steps: steps || 0 };
    },
};

const asked = JSON.parse(fs.readFileSync(0));
const tasks = [];
const job = {
    name: asked.name,
    settings: asked.settings,
    addTask(task) { // as it is now: the manager copies it
        const { id, name, type, commands, needs } = task;
        tasks.push(structuredClone({ id, name, type, commands, needs }));
    },
};
const path = { basename: paths.basename, dirname: paths.dirname, join: paths.join, stem: (p) => paths.parse(p).name };
const globals = { author, path, frameChunker, shellSplit, print() {}, alert() {} };
globals.frameCount = (range) => explode(range).length;
const script = '"use strict";' + fs.readFileSync(process.argv[2], "utf-8") + "\n;({ JOB_TYPE, compileJob });";
const { JOB_TYPE, compileJob } = vm.runInContext(script, vm.createContext(globals));
if (asked.settings) {
    compileJob(job);
}
process.stdout.write(JSON.stringify({ type: JOB_TYPE, tasks: tasks }));
