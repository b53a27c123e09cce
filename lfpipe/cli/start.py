"""`lfpipe` without arguments on a desktop: a session that begins with thumbnails of the demo and of recent scenes."""


def start() -> int:
    """Runs the session, with the demo's viewer if there is no camera; returns the exit code."""
    from lfpipe import config as config_module
    from lfpipe.capture.open_source import check_source
    from lfpipe.cli.launch import UpArguments, say, up
    from lfpipe.errors import UserError
    from lfpipe.scene.cache import cache_dir
    from lfpipe.scene.demo import demo_scene
    from lfpipe.scene.recent_scenes import recent_scenes

    config = config_module.load(None, ())
    camera = None
    try:
        check_source(config.camera.source, config.camera)
    except UserError as error:
        say(f"using the demo's face instead of a camera: {error.message}")
        camera = "demo"
    demo = demo_scene(cache_dir(config.scene))
    return up(
        UpArguments(camera=camera, scenes=(demo, *(scene for scene in recent_scenes() if scene != demo.resolve())), start=True)
    )
