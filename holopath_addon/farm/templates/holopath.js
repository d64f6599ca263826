// Flamenco's job type "HoloPath": the frames of an animation as holograms, on Flamenco 3.6 and later.
// Put this file into the folder "scripts" beside the program flamenco-manager, and press Refresh from Manager in
// Blender. The workers' Blender needs the extension HoloPath.

const JOB_TYPE = {
    label: "HoloPath",
    description: "Render the frames of an animation as phase holograms",
    settings: [
        { key: "frames", type: "string", required: true,
          eval: "f'{C.scene.frame_start}-{C.scene.frame_end}' if C.scene.frame_step == 1 else " +
                "','.join(map(str, range(C.scene.frame_start, C.scene.frame_end + 1, C.scene.frame_step)))",
          evalInfo: {
            showLinkButton: true,
            description: "Scene frame range",
          },
          description: "Frames to render. Examples: '47', '1-30', '3, 5-10, 47-327'" },
        { key: "chunk_size", type: "int32", default: 4, propargs: {min: 1}, visible: "submission",
          description: "Number of frames that a worker renders in a row. It opens the file once for them" },

        { key: "render_output_root", type: "string", subtype: "dir_path", required: true, visible: "submission",
          description: "Folder, shared by all workers, that the job's own folder is made in" },
        { key: "add_path_components", type: "int32", required: true, default: 0, propargs: {min: 0, max: 32},
          visible: "submission",
          description: "Number of path components of the current blend file to use in the output folder" },
        // Without the time: the same job again goes on where it was stopped, and renders what was changed.
        { key: "render_output_path", type: "string", subtype: "dir_path", editable: false,
          eval: "str(Path(abspath(settings.render_output_root), " +
                "last_n_dir_parts(settings.add_path_components), jobname))",
          description: "Folder of this job's frames. A folder of before is gone on with" },

        { key: "encode", type: "string", choices: ["none", "dpac", "auto", "sgd", "joint", "refine"],
          default: "none", description: "Phases for an SLM, made with each frame" },
        { key: "words", type: "string", label: "More Words", default: "",
          description: "Further words for holopath render. Example: --method fast --focus 0.5m,2m" },

        { key: "blendfile", type: "string", required: true, visible: "web",
          description: "Path of the Blend file to render" },
    ]
};

function compileJob(job) {
    const settings = job.settings;
    const frames = frameChunker(settings.frames, 1);

    // What is wrong with the file is told once, and no worker only waits for the light that the first task finds for all.
    const first = renderTask(settings, frames[0]);
    job.addTask(first);
    if (frames.length == 1) {
        return;
    }
    for (let chunk of frameChunker(frames.slice(1).join(","), settings.chunk_size)) {
        const task = renderTask(settings, chunk);
        task.addDependency(first);
        job.addTask(task);
    }
}

function renderTask(settings, chunk) {
    let args = [
        "--command", "holopath", "render", settings.blendfile,
        "--out", settings.render_output_path,
        "--frame-range", chunk,
    ];
    // Phases are made by the task that renders: side by side, and with the scene at hand.
    if (settings.encode && settings.encode != "none") {
        args.push("--encode", settings.encode);
    }
    for (let word of shellSplit(settings.words || "")) {
        args.push(word);
    }
    const task = author.Task(`render-${chunk}`, "blender");
    task.addCommand(author.Command("blender-render", {
        exe: "{blender}",
        exeArgs: "{blenderArgs}",
        argsBefore: ["--background"],
        blendfile: "", // HoloPath opens it
        args: args,
    }, frameChunker(chunk, 1).length));
    return task;
}
