// The shading of render/analytic.py, formula by formula, for one point light. PRINCIPLED,
// MIN_ALPHA, F0_LOW, F0_HIGH and DIELECTRIC_F0 are defined by viewer.js from the package's own constants. Directions are in the
// surface's frame: +x along u, +y up, +z out of the surface. Lengths are in patch sides.
//
// The patch is cut as Mitsuba cuts it: black where light or camera is behind the surface or behind the normal of the texel.
// On the sphere that would leave holes at its rim and a hard edge of its shadow; there only light behind the normal is cut.
precision highp float;
precision highp int;
precision highp sampler2D;

const float PI = 3.14159265358979;
const int RECTIFIED = 0, PATCH = 1, SPHERE = 2;      // surface
const int LIT = 0, COLOUR = 1, SECOND = 2, ROUGHNESS = 3, NORMAL = 4;  // show

uniform sampler2D colourMap;  // rgb: diffuse or base colour; a: roughness
uniform sampler2D secondMap;  // rgb: specular; r: metallic
uniform sampler2D normalMap;
uniform vec3 camera, light, intensity;
uniform mat3 axes;            // of the camera: right, up, back
uniform vec2 span;            // of the picture, in pixels
uniform float zoom, exposure, roughnessScale;
uniform vec4 uses;            // colour, second, roughness, normal: 1 or 0
uniform int surface, show, samples, tiles;
uniform bool linearOutput;

out vec4 pixel;

struct Texel { vec3 colour, second, normal; float roughness; };
// frame: along u, up, outward; uv: (0, 0) is the top left corner; flip: -1 along an axis where the maps are mirrored.
struct Point { vec3 position; mat3 frame; vec2 uv; vec3 flip; };

vec4 lookUp(sampler2D map, vec2 uv) {  // bilinear, so that the card need not filter float textures
  ivec2 last = textureSize(map, 0) - 1;
  vec2 at = uv * vec2(last + 1) - 0.5, low = floor(at), t = at - low;
  ivec2 a = clamp(ivec2(low), ivec2(0), last), b = clamp(ivec2(low) + 1, ivec2(0), last);
  return mix(mix(texelFetch(map, a, 0), texelFetch(map, ivec2(b.x, a.y), 0), t.x),
             mix(texelFetch(map, ivec2(a.x, b.y), 0), texelFetch(map, b, 0), t.x), t.y);
}

Texel texelAt(vec2 uv) {
  vec4 colour = lookUp(colourMap, uv);
  return Texel(colour.rgb, lookUp(secondMap, uv).rgb, normalize(lookUp(normalMap, uv).xyz), colour.a);
}

// 2 cos / G1 of GGX masking, one direction (Walter et al. 2007, eq. 34).
float smith(float a2, float cosine) { return cosine + sqrt(a2 + (1.0 - a2) * cosine * cosine); }

// The density of half vectors; across2 is |n x h|^2, since 1 - n.h^2 would cancel.
float density(float a2, float n_h, float across2) { float d = a2 * n_h * n_h + across2; return a2 / (PI * d * d); }

// Unpolarised Fresnel reflectance of the real refractive index that has this F0; proportional to F0 beyond its range.
vec3 fresnel(vec3 f0, float cosine) {
  vec3 cut = clamp(f0, F0_LOW, F0_HIGH), s = sqrt(cut);
  vec3 a = (1.0 - cut) / (1.0 + s), ac = a * cosine, g = sqrt(4.0 * s + ac * ac);
  vec3 s_wave = 1.0 / ((ac + g) * (ac + g)), p = (1.0 + s) * (1.0 + s) * cosine + a * g;
  vec3 p_wave = (2.0 * cosine * cosine * (1.0 + cut) - a * a) / (p * p);
  return 8.0 * f0 * (s_wave * s_wave + p_wave * p_wave);
}

float fifth(float x) { return x * x * x * x * x; }  // pow is undefined at 0 in places

vec3 specularColour(Texel m, float h_l) {
#ifdef PRINCIPLED
  vec3 metal = m.colour + (1.0 - m.colour) * fifth(1.0 - h_l);
  return m.second.r * metal + (1.0 - m.second.r) * fresnel(vec3(DIELECTRIC_F0), h_l);
#else
  return fresnel(m.second, h_l);
#endif
}

vec3 diffuseColour(Texel m, float n_l, float n_v, float h_l) {  // pi times the diffuse BRDF
#ifdef PRINCIPLED
  float w_l = fifth(1.0 - n_l), w_v = fifth(1.0 - n_v), retro = 2.0 * m.roughness * h_l * h_l;
  return (1.0 - m.second.r) * m.colour * ((1.0 - w_l / 2.0) * (1.0 - w_v / 2.0) + retro * (w_l + w_v + w_l * w_v * (retro - 1.0)));
#else
  return m.colour;
#endif
}

bool cut(float n_l, float n_v, vec3 l) { return n_l <= 0.0 || surface != SPHERE && (n_v <= 0.0 || l.z <= 0.0); }

// The BRDF times n.l. v and l are unit vectors toward camera and light.
vec3 reflected(Texel m, vec3 v, vec3 l) {
  float n_l = dot(m.normal, l), n_v = dot(m.normal, v);
  if (cut(n_l, n_v, l)) return vec3(0);
  n_v = max(n_v, 0.0);
  vec3 h = normalize(l + v), across = cross(m.normal, h);
  float h_l = dot(h, l), alpha = max(m.roughness * m.roughness, MIN_ALPHA), a2 = alpha * alpha;
  // D G / (4 n.v) without its F, times n.l.
  float lobe = density(a2, dot(m.normal, h), dot(across, across)) * n_l / (smith(a2, n_l) * smith(a2, n_v));
  return diffuseColour(m, n_l, n_v, h_l) / PI * n_l + lobe * specularColour(m, h_l);
}

vec3 radiance(Point p) {
  Texel m = texelAt(p.uv);
  m.colour *= uses.x;
  m.second *= uses.y;
  m.roughness = min((uses.z > 0.0 ? m.roughness : 0.5) * roughnessScale, 1.0);
  m.normal = uses.w == 0.0 ? vec3(0, 0, 1) : m.normal * p.flip;
  vec3 toLight = light - p.position, v = normalize(camera - p.position) * p.frame;
  return reflected(m, v, normalize(toLight) * p.frame) * intensity / dot(toLight, toLight);
}

float encoded(float x) { return x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1.0 / 2.4) - 0.055; }
vec3 encoded(vec3 x) { return vec3(encoded(x.r), encoded(x.g), encoded(x.b)); }

vec3 shown(Point p) {  // linear radiance, or the value of one map
  if (show == LIT) return radiance(p) * exposure;
  Texel m = texelAt(p.uv);
#ifdef PRINCIPLED
  m.second = m.second.rrr;
#endif
  return show == COLOUR ? m.colour : show == SECOND ? m.second : show == ROUGHNESS ? vec3(m.roughness) : m.normal * p.flip * 0.5 + 0.5;
}

bool seen(vec2 at, out Point p) {  // at: from -1 to 1 over the picture, +y up
  p.flip = vec3(1);
  if (surface == RECTIFIED) {
    p = Point(vec3(at / 2.0, 0), mat3(1), vec2(0.5, 0.5) + vec2(at.x, -at.y) / 2.0, vec3(1));
    return true;
  }
  vec3 ray = normalize(axes * vec3(at, -zoom));
  if (surface == PATCH) {
    p.position = camera - ray * (camera.z / ray.z);
    p.frame = mat3(1);
    p.uv = vec2(0.5) + vec2(p.position.x, -p.position.y);
    if (ray.z >= 0.0 || any(lessThan(p.uv, vec2(0))) || any(greaterThan(p.uv, vec2(1)))) return false;
  } else {  // a ball of diameter 1; one tile from pole to pole, and one over the front half; every other one is mirrored
    float b = dot(camera, ray), inside = b * b - dot(camera, camera) + 0.25;
    if (inside < 0.0) return false;
    p.position = camera - ray * (b + sqrt(inside));
    vec3 n = normalize(p.position);
    float around = length(n.xz);
    vec3 u = around > 0.0 ? vec3(n.z, 0, -n.x) / around : vec3(1, 0, 0);
    p.frame = mat3(u, cross(n, u), n);
    p.uv = vec2(0.5) + vec2(atan(n.x, n.z), -asin(clamp(n.y, -1.0, 1.0))) / PI;
  }
  p.uv *= float(tiles);
  vec2 odd = surface == SPHERE ? mod(floor(p.uv), 2.0) : vec2(0);
  p.uv = mix(fract(p.uv), 1.0 - fract(p.uv), odd);
  p.flip = vec3(1.0 - 2.0 * odd, 1);
  return true;
}

void main() {
  vec3 sum = vec3(0);
  float hits = 0.0, count = float(samples * samples);
  for (int y = 0; y < samples; y++) for (int x = 0; x < samples; x++) {
    Point p;
    vec2 inside = (vec2(x, y) + 0.5) / float(samples);
    if (seen((floor(gl_FragCoord.xy) + inside) / span * 2.0 - 1.0, p)) { sum += shown(p); hits += 1.0; }
  }
  if (hits == 0.0) { pixel = vec4(0); return; }
  vec3 mean = sum / hits;
#ifdef PRINCIPLED
  bool colour = show == LIT || show == COLOUR;
#else
  bool colour = show == LIT || show == COLOUR || show == SECOND;
#endif
  if (!linearOutput) mean = clamp(colour ? encoded(mean) : mean, 0.0, 1.0);
  pixel = vec4(mean * hits / count, hits / count);  // premultiplied
}
