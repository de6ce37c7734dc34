// 3-D models: the scene's meshes by material, and the radar's platform.

import * as THREE from "three";
import { GLTFLoader } from "three/gltf_loader";

// visual appearance of materials, by words in their names
const MATERIALS = [
  [/water/, 0x2f6f9f], [/grass|leaves|veget|tree/, 0x5f8f4a], [/soil|ground|earth|sand/, 0x8d7b5e],
  [/asphalt|road|street/, 0x5d6269], [/paving|stone|marble/, 0x9a968c], [/glass/, 0x86b7c9],
  [/metal|steel|pec|alumin|iron/, 0xb9c3cc], [/brick|tile/, 0xa5644c], [/gravel/, 0x8d8a83], [/wood|plywood|chip/, 0xa58257],
  [/concrete|plaster|ceiling/, 0xa9aaa6],
];
const PLAIN = [0xa9aaa6, 0xb59f7b, 0x8f9fb5, 0x9fb58f, 0xb58f9f];

function materialColour(name, index) {
  const found = MATERIALS.find(([words]) => words.test(name.toLowerCase()));
  return found ? found[1] : PLAIN[index % PLAIN.length];
}

/** Release the memory of a group, and empty it. */
export function cleared(group) {
  group.traverse((part) => {
    part.geometry?.dispose();
    part.material?.dispose();
  });
  group.clear();
}

/** The meshes of one scene of the page as a group; every mesh knows its name and its material. */
export async function loadModel(facts) {
  const model = new THREE.Group();
  if (!facts.glb.length) return model;
  const gltf = await new GLTFLoader().parseAsync(facts.glb.buffer, "");
  for (const part of [...gltf.scene.children]) {
    // "mesh/material"; names of nodes lose their slash
    const [mesh, material] = (part.userData.name ?? part.name).split(/[/_]/).map(Number);
    part.traverse((node) => {
      if (!node.isMesh) return;
      node.geometry.deleteAttribute("normal");
      const colour = materialColour(facts.materials[material] ?? "", material);
      node.material = new THREE.MeshLambertMaterial({ color: colour, side: THREE.DoubleSide, flatShading: true });
      node.castShadow = true;
      node.receiveShadow = true;
      node.userData = { mesh: facts.meshes[mesh] ?? "", material: facts.materials[material] ?? "" };
    });
    model.add(part);
  }
  return model;
}

/** An aeroplane that flies towards its -y, `size` metres from its middle to its nose. */
export function platformModel(size) {
  const skin = new THREE.MeshLambertMaterial({ color: 0xf2f5f8, emissive: 0x556677 });
  const body = new THREE.Mesh(new THREE.CylinderGeometry(0.13 * size, 0.2 * size, 2 * size, 12), skin);
  const nose = new THREE.Mesh(new THREE.ConeGeometry(0.2 * size, 0.5 * size, 12), skin);
  nose.position.y = -1.25 * size;
  nose.rotation.x = Math.PI;
  const wing = new THREE.Mesh(new THREE.BoxGeometry(2.6 * size, 0.4 * size, 0.07 * size), skin);
  const tail = new THREE.Mesh(new THREE.BoxGeometry(0.9 * size, 0.25 * size, 0.06 * size), skin);
  tail.position.y = 0.85 * size;
  const fin = new THREE.Mesh(new THREE.BoxGeometry(0.06 * size, 0.3 * size, 0.5 * size), skin);
  fin.position.set(0, 0.85 * size, 0.25 * size);
  const group = new THREE.Group();
  group.add(body, nose, wing, tail, fin);
  return group;
}
