// Job type of Flamenco 3: motion blur of rendered frames, a task for each chunk of them.

const JOB_TYPE = {
    label: "Motion blur (jaxblur)",
    settings: [
        { key: "input", type: "string", subtype: "file_path", required: true,
          description: "Sharp frames: /render/shot/######.exr" },
        { key: "output", type: "string", subtype: "file_path", required: true,
          description: "Blurred frames, in a folder that exists: /render/shot/blurred_######.exr" },
        { key: "frames", type: "string", required: true,
          eval: "f'{C.scene.frame_start}-{C.scene.frame_end}'",
          description: "Frames to blur, such as 1-30 or 3,5-10" },
        { key: "chunk_size", type: "int32", default: 20, propargs: { min: 1 },
          description: "Frames of a task; it takes some seconds to start" },
        { key: "filter", type: "string", default: "layered",
          choices: ["layered", "guertin2014", "mcguire2012", "pixel_velocity"] },
        { key: "shutter", type: "float", eval: "C.scene.render.motion_blur_shutter",
          default: 0.5, description: "Exposure in frames" },
        { key: "options", type: "string", default: "--radius auto",
          description: "Further options of `jaxblur blur`, separated by blanks" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    const options = settings.options.split(" ").filter((option) => option.length > 0);
    for (const chunk of frameChunker(settings.frames, settings.chunk_size)) {
        const task = author.Task(`blur-${chunk}`, "misc");
        task.addCommand(author.Command("exec", {
            exe: "{jaxblur}",
            args: [
                "blur", settings.input, "-o", settings.output,
                `--filter=${settings.filter}`,
                `--shutter=${settings.shutter}frames`,
                `--frames=${chunk}`,
            ].concat(options),
        }));
        job.addTask(task);
    }
}
