"""Several meshes in one picture."""

from __future__ import annotations

from typing import Any

from anyio import to_thread
from fastapi import APIRouter, Request, Response

from schemas.errors import SilhouetteError
from schemas.manifest import Manifest
from schemas.scene import SceneRequest
from service.access.caller import caller_of
from service.assets import state_of
from service.caching import REVALIDATE, entity_tag, not_modified
from service.errors import located
from service.negotiation import IMAGE_TYPES, image_format
from service.owners import owner_of
from service.render.encode import encode
from service.render.renderer import samples_of
from service.routes.documented import image_answer, problems
from service.routes.render import check_drawable, picture_headers
from service.scene.draw import drawing_of
from service.scene.plan import ScenePlan, plan_scene
from service.state import Parts, Services
from service.waiting import Stopwatch, wait_for

router = APIRouter(prefix="/v1/scenes", tags=["pictures"])

SCENES: dict[str, Any] = {
    "response_class": Response,
    "responses": image_answer(*IMAGE_TYPES.values()) | problems(404, 406, 409, 422, 503),
}


@router.post("/render", **SCENES)
async def render_scene(body: SceneRequest, request: Request, parts: Parts) -> Response:
    """One picture of several meshes with transforms: each clipped and antialiased on its own, then laid over one another.

    With `lines` all are drawn together from their originals, so that lines of one are hidden by the others.
    """
    caller_of(request).check_picture(body.width, body.height)
    encoding = body.format or image_format(request.headers.get("accept"))
    wanted = body.model_copy(update={"format": encoding})
    manifests = await to_thread.run_sync(_manifests, parts, wanted)
    tag = entity_tag("scene", *map(state_of, manifests), wanted.resolved().model_dump_json())
    if answer := not_modified(request, tag, REVALIDATE):
        return answer
    limit_s = parts.settings.render_timeout_s
    plan, plan_ms = await wait_for(request, parts.cpu.submit(_plan, parts, wanted, manifests), limit_s)
    image = await wait_for(request, parts.renderer.submit_drawing(drawing_of(plan), owner_of(request), samples_of(wanted)), limit_s)
    clock = Stopwatch()
    picture = await wait_for(request, parts.cpu.submit(encode, image.pixels, encoding), limit_s)
    told = picture_headers(image, before=[("plan", plan_ms)], after=[("encode", clock.ms())])
    return Response(picture, headers={"ETag": tag, "Cache-Control": REVALIDATE, "Vary": "Accept", **told}, media_type=IMAGE_TYPES[encoding])


def _manifests(parts: Services, wanted: SceneRequest) -> list[Manifest]:
    """What can be drawn of every object's mesh. What is wrong with one says whose it is."""
    found = []
    for index, item in enumerate(wanted.objects):
        try:
            found.append(_drawable(parts, wanted, item.mesh))
        except SilhouetteError as error:
            raise located(error, f"objects[{index}].mesh") from error.__cause__
    return found


def _drawable(parts: Services, wanted: SceneRequest, mesh_id: str) -> Manifest:
    manifest = parts.meshes.drawable(mesh_id)
    check_drawable(manifest, wanted.accuracy)
    return manifest


def _plan(parts: Services, wanted: SceneRequest, manifests: list[Manifest]) -> tuple[ScenePlan, float]:
    """The plan, and the milliseconds it took once the meshes were there."""
    assets = [parts.assets.get(manifest) for manifest in manifests]
    clock = Stopwatch()
    return plan_scene(wanted, assets), clock.ms()
