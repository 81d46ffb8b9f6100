// A renderer and a camera of three.js as the address asks: ?look={scene, width, height, fov, world_from_cam (rows, OpenGL)}.

export const look = JSON.parse(new URLSearchParams(location.search).get("look"));

export function rendererOf(THREE) {
  const renderer = new THREE.WebGLRenderer({ antialias: false });
  renderer.setPixelRatio(1);
  renderer.setSize(look.width, look.height);
  document.body.append(renderer.domElement);
  return renderer;
}

export function cameraOf(THREE) {
  const camera = new THREE.PerspectiveCamera(look.fov, look.width / look.height, 0.05, 100);
  new THREE.Matrix4().set(...look.world_from_cam).decompose(camera.position, camera.quaternion, camera.scale);
  camera.updateMatrixWorld();
  return camera;
}
