"""Shaders of the OpenGL renderer and the memory layout of their vertices. Compiles no shader.

Colour has two pairs of shaders, because llvmpipe executes the texture lookup for every pixel of a shader that contains
one, and lookups take half the time of a frame. A third pair renders depth and ids only. No shader writes depth: the
depth buffer is the depth image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

VERTEX = np.dtype(
    [
        ("position", "3f4"),
        ("uv", "2f4"),
        ("light_uv", "2f4"),
        ("colour", "4u1"),
        ("instance", "u2"),
        ("layer", "i2"),
    ]
)
"""Layout of one vertex; instance and texture layer are those of its part."""


class ShaderPair(NamedTuple):
    """Source of a shader program, and the fields of `VERTEX` that it reads."""

    vertex: str
    """Source of the vertex shader."""
    fragment: str
    """Source of the fragment shader."""
    layout: str
    """Buffer format of the fields in moderngl's notation; `x` skips bytes."""
    fields: tuple[str, ...]
    """Names of the fields."""

    def blended(self) -> ShaderPair:
        """Returns the pair for triangles with a colour per corner; interpolating it takes 2 % of a frame's time."""
        return self._replace(
            vertex=self.vertex.replace("flat out vec3", "out vec3"),
            fragment=self.fragment.replace("flat in vec3", "in vec3"),
        )

    def cut_out(self) -> ShaderPair:
        """Returns the pair for parts whose texture cuts holes: it discards the points that its mask does not draw."""
        head, layout, fields = "", self.layout, self.fields
        vertex, fragment = self.vertex, self.fragment
        if "uv" not in fields:
            layout, fields = "3f4 2f4 12x 1u2 1i2", ("position", "uv", "instance", "layer")
            vertex = vertex.replace("void main() {", _UV_OUT + "void main() {\n    frag_uv = uv; frag_layer = layer;")
            head = "in vec2 frag_uv; flat in int frag_layer;\n"
        head += "uniform sampler2DArray masks;\nvoid main() {"
        # at the end, because derivatives are undefined after a discard
        fragment = fragment.replace("void main() {", head).rstrip().removesuffix("}") + _DISCARD + "}\n"
        return ShaderPair(vertex, fragment, layout, fields)


_UV_OUT = "in vec2 uv; in int layer; out vec2 frag_uv; flat out int frag_layer;\n"
_DISCARD = "    if (textureLod(masks, vec3(frag_uv, float(frag_layer)), 0.0).r < 0.5) discard;\n"
"""The full mask without mipmaps, whose means would close or open all holes of distant leaves."""

PLAIN = ShaderPair(
    """
#version 330
in vec3 position; in vec2 light_uv; in vec4 colour; in int instance;
uniform mat4 clip_from_world;
out vec2 frag_light; flat out vec3 frag_colour; flat out int frag_instance;
void main() {
    gl_Position = clip_from_world * vec4(position, 1.0);
    frag_light = light_uv; frag_colour = colour.rgb; frag_instance = instance;
}
""",
    """
#version 330
in vec2 frag_light; flat in vec3 frag_colour; flat in int frag_instance;
uniform sampler2D light;
layout(location = 0) out vec4 rgb; layout(location = 1) out uint id;
void main() {
    rgb = vec4(frag_colour * texture(light, frag_light).rgb, 1.0);
    id = uint(frag_instance);
}
""",
    "3f4 8x 2f4 4f1 1u2 2x",
    ("position", "light_uv", "colour", "instance"),
)
"""Shaders of parts without texture, with one colour per triangle."""

TEXTURED = ShaderPair(
    """
#version 330
in vec3 position; in vec2 uv; in vec2 light_uv; in vec4 colour; in int instance; in int layer;
uniform mat4 clip_from_world;
out vec2 frag_uv; out vec2 frag_light; flat out vec3 frag_colour; flat out int frag_instance; flat out int frag_layer;
void main() {
    gl_Position = clip_from_world * vec4(position, 1.0);
    frag_uv = uv; frag_light = light_uv; frag_colour = colour.rgb; frag_instance = instance; frag_layer = layer;
}
""",
    """
#version 330
in vec2 frag_uv; in vec2 frag_light; flat in vec3 frag_colour; flat in int frag_instance; flat in int frag_layer;
uniform sampler2DArray layers; uniform sampler2D light;
layout(location = 0) out vec4 rgb; layout(location = 1) out uint id;
void main() {
    vec3 surface = frag_colour * texture(layers, vec3(frag_uv, float(frag_layer))).rgb;
    rgb = vec4(surface * texture(light, frag_light).rgb, 1.0);
    id = uint(frag_instance);
}
""",
    "3f4 2f4 2f4 4f1 1u2 1i2",
    ("position", "uv", "light_uv", "colour", "instance", "layer"),
)
"""Shaders of parts with a texture."""

BARE = ShaderPair(
    """
#version 330
in vec3 position; in int instance;
uniform mat4 clip_from_world;
flat out int frag_instance;
void main() {
    gl_Position = clip_from_world * vec4(position, 1.0);
    frag_instance = instance;
}
""",
    """
#version 330
flat in int frag_instance;
layout(location = 1) out uint id;
void main() {
    id = uint(frag_instance);
}
""",
    "3f4 20x 1u2 2x",
    ("position", "instance"),
)
"""Shaders for depth and ids of any part, without colour. A benchmark uses them to measure the cost of colour."""

NORMALS = ShaderPair(
    """
#version 330
in vec3 position; in int instance;
uniform mat4 clip_from_world; uniform vec3 eye;
out vec3 frag_ray; flat out int frag_instance;
void main() {
    gl_Position = clip_from_world * vec4(position, 1.0);
    frag_ray = position - eye; frag_instance = instance;
}
""",
    """
#version 330
in vec3 frag_ray; flat in int frag_instance;
layout(location = 0) out vec4 rgb; layout(location = 1) out uint id;
void main() {
    vec3 normal = cross(dFdx(frag_ray), dFdy(frag_ray));
    normal /= max(abs(normal.x) + abs(normal.y) + abs(normal.z), 1e-30);
    normal *= dot(normal, frag_ray) > 0.0 ? -1.0 : 1.0;
    vec2 side = vec2(normal.x >= 0.0 ? 1.0 : -1.0, normal.y >= 0.0 ? 1.0 : -1.0);
    vec2 folded = normal.z >= 0.0 ? normal.xy : (1.0 - abs(normal.yx)) * side;
    uvec2 steps = uvec2(round((folded * 0.5 + 0.5) * 4095.0));
    rgb = vec4(steps.x >> 4, (steps.x & 15u) << 4 | steps.y >> 8, steps.y & 255u, 255.0) / 255.0;
    id = uint(frag_instance);
}
""",
    "3f4 20x 1u2 2x",
    ("position", "instance"),
)
"""Shaders for normals of the triangles in the world frame, towards the camera. The 24 bits of a colour store the two
coordinates of the octahedral map with 12 bits each, which corresponds to 0.03 degrees (Z. H. Cigolle et al., "A Survey
of Efficient Representations for Independent Unit Vectors", JCGT 3(2), 2014)."""
