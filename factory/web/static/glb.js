// Reads a binary glTF file of `factory export --to vlnce` as three.js meshes: unlit colours and textures, no hierarchy.
import { BufferAttribute, BufferGeometry, Group, Mesh, MeshLambertMaterial, RepeatWrapping, SRGBColorSpace, Texture } from "./vendor/three.module.min.js";

const ARRAYS = { 5120: Int8Array, 5121: Uint8Array, 5122: Int16Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };
const SIZES = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 };
const ATTRIBUTES = { position: "POSITION", uv: "TEXCOORD_0", color: "COLOR_0" };

export async function readGlb(url) {
  const reply = await fetch(url);
  if (!reply.ok) throw new Error(await reply.text());
  const data = await reply.arrayBuffer();
  const jsonBytes = new DataView(data).getUint32(12, true);
  const tree = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 20, jsonBytes)));
  const first = 20 + jsonBytes + 8;
  const bytes = ({ byteOffset = 0, byteLength }) => new Uint8Array(data, first + byteOffset, byteLength);
  const array = (index) => {
    const { bufferView, byteOffset = 0, componentType, count, type, normalized = false } = tree.accessors[index];
    const begin = first + (tree.bufferViews[bufferView].byteOffset ?? 0) + byteOffset;
    const size = SIZES[type];
    return new BufferAttribute(new ARRAYS[componentType](data, begin, count * size), size, normalized);
  };
  const group = new Group();
  for (const { primitives } of tree.meshes) {
    const { attributes, indices, material } = primitives[0];
    const geometry = new BufferGeometry();
    for (const [ours, theirs] of Object.entries(ATTRIBUTES))
      if (theirs in attributes) geometry.setAttribute(ours, array(attributes[theirs]));
    if (indices !== undefined) geometry.setIndex(array(indices));
    geometry.computeVertexNormals();
    const source = tree.materials[material]?.pbrMetallicRoughness?.baseColorTexture;
    const map = source ? await readTexture(tree.images[tree.textures[source.index].source], tree, bytes) : null;
    group.add(new Mesh(geometry, new MeshLambertMaterial({ map, vertexColors: true })));
  }
  return group;
}

async function readTexture({ bufferView, mimeType }, tree, bytes) {
  const image = await createImageBitmap(new Blob([bytes(tree.bufferViews[bufferView])], { type: mimeType }));
  const texture = new Texture(image);
  texture.flipY = false;
  texture.wrapS = texture.wrapT = RepeatWrapping;
  texture.colorSpace = SRGBColorSpace;
  texture.needsUpdate = true;
  return texture;
}
