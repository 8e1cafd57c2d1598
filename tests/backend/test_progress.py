from backend.progress import KEEP_S, Progress

MESH = "a" * 32


def test_progress_is_read_by_others_and_expires(connection):
    Progress(connection).report(MESH, "hull", 0.25)
    assert Progress(connection).read(MESH) == {"hull": 0.25}
    assert 0 < connection.ttl(f"silhouette:progress:{MESH}") <= KEEP_S


def test_reports_in_quick_succession_are_dropped_but_never_first_and_last(connection):
    progress = Progress(connection)
    for step in range(1001):
        progress.report(MESH, "hull", step / 1000)
    assert progress.read(MESH) == {"hull": 1.0}
    progress.report(MESH, "hull", 0.5)
    assert progress.read(MESH) == {"hull": 1.0}


def test_fractions_stay_between_none_and_all(connection):
    progress = Progress(connection)
    progress.report(MESH, "hull", 7.0)
    progress.report(MESH, "tree", -1.0)
    assert progress.read(MESH) == {"hull": 1.0, "tree": 0.0}


def test_listeners_hear_of_changes(connection):
    progress = Progress(connection)
    with connection.pubsub(ignore_subscribe_messages=True) as listener:
        listener.subscribe(Progress.channel(MESH))
        listener.get_message(timeout=1)
        progress.report(MESH, "tree", 0.5)
        progress.notify(MESH)
        heard = [m["data"] for m in (listener.get_message(timeout=2) for _ in range(2)) if m]
    assert heard == [b"tree", b""]


def test_cleared_progress_is_gone(connection):
    progress = Progress(connection)
    progress.report(MESH, "tree", 0.5)
    progress.clear(MESH)
    assert progress.read(MESH) == {}
