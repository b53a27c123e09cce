// Draws both eyes' views of a light field and mixes them, in one pass: what engine.py, warper.py and
// anaglyph.py do on the processor, which explain it. GLSL 3.30 and, for the exported page, GLSL ES
// 3.00; who compiles it puts the version before.

uniform sampler2DArray views;        // stored views, one per layer
uniform sampler2DArray disparities;  // half their size: level, 0 if unknown; highest level of WINDOW
                                     // x WINDOW from here on; 0 if none is unknown around, 1 if all
uniform vec2 size;                   // of the picture, px
uniform float unit;                  // px per view for each level above MIDDLE
uniform float span;                  // between the farthest and the nearest point, px per view
// Four of the left eye, then four of the right eye; weight 0: not used.
uniform vec4 sights[8];              // layer, weight, steps from the camera: right, down
uniform vec4 fades[8];               // where disparity is unknown: layer, weight, move: right, down
uniform vec2 shift[2];               // that brings the zero plane into the screen, px right, down
// Red, green, blue of the picture.
uniform vec4 own[3];                 // weights of red, green, blue of an eye, and which eye
uniform vec4 crossed[3];
uniform vec2 gains[3];               // of the two
uniform bvec2 linear;                // whether the weights, and the gains, apply to linear light

in vec2 at;                          // 0 to 1 from the first pixel of the picture
out vec4 picture;

const float MIDDLE = 128.0, WINDOW = 4.0, CAREFUL_PX = 1.0, STEPS_PER_PX = 1024.0;

vec2 cells() { return vec2(textureSize(disparities, 0).xy); }

vec3 entry(vec2 cell, float layer) {
  vec2 inside = clamp(cell, vec2(0.0), cells() - 1.0);
  return floor(texelFetch(disparities, ivec3(vec3(inside, layer)), 0).rgb * 255.0 + 0.5);
}

// The disparity at the cell where a block lands if its own is d, px per view; 0 if unknown.
float landing(float d, vec2 block, vec4 sight, vec2 by) {
  vec2 moved = floor((d * sight.zw + by) * STEPS_PER_PX + 0.5) / STEPS_PER_PX;
  float level = entry(block + floor(moved * cells() / size + 0.5), sight.x).r;
  return level == 0.0 ? 0.0 : (level - MIDDLE) * unit;
}

// The disparity of the nearest surface within reach of a block.
float nearest(vec2 block, vec2 reach, float layer) {
  vec2 low = max(block - reach, vec2(0.0)), high = min(block + reach, cells() - 1.0);
  bool wide = all(greaterThanEqual(high - low, vec2(WINDOW - 1.0)));
  float pace = wide ? WINDOW : 1.0, level = 0.0;
  for (float y = low.y; y <= high.y; y += pace)
    for (float x = low.x; x <= high.x; x += pace)
      level = max(level, wide ? entry(min(vec2(x, y), high - WINDOW + 1.0), layer).g
        : entry(vec2(x, y), layer).r);
  return (level - MIDDLE) * unit;
}

// What a camera saw of the pixel: two steps of the fixed point d(x + d * steps).
vec3 warped(vec2 pixel, vec4 sight, vec2 by) {
  vec2 block = floor(pixel / 2.0), spread = abs(sight.zw) * span;
  bool careful = max(spread.x, spread.y) >= CAREFUL_PX;
  float level = entry(block, sight.x).r, first = level == 0.0 ? 0.0 : (level - MIDDLE) * unit;
  if (careful) {
    first = nearest(block, ceil(spread * cells() / size), sight.x);
    first = landing(first, block, sight, by);
  }
  float second = landing(first, block, sight, by), d = careful ? max(first, second) : second;
  return textureLod(views, vec3((pixel + 0.5 + d * sight.zw + by) / size, sight.x), 0.0).rgb;
}

// Share of the cross-fade in a pixel: where most views do not know their disparity, over five cells.
float unknown(vec2 pixel, int eye) {
  vec2 place = (pixel + 0.5 + floor(shift[eye] + 0.5)) / 2.0;
  float around = 0.0, share = 0.0;
  for (int k = 4 * eye; k < 4 * eye + 4; k++)
    around += fades[k].y * textureLod(disparities, vec3(place / cells(), fades[k].x), 0.0).b;
  if (around == 0.0 || around > 0.999) return around;
  vec2 cell = floor(place - 0.5), part = fract(place - 0.5);
  for (float y = -2.0; y <= 3.0; y++)
    for (float x = -2.0; x <= 3.0; x++) {
      float more = -1.0;
      for (int k = 4 * eye; k < 4 * eye + 4; k++)
        if (fades[k].y > 0.0 && entry(cell + vec2(x, y), fades[k].x).r == 0.0)
          more += 2.0 * fades[k].y;
      vec2 weight = vec2(x == -2.0 ? 1.0 - part.x : x == 3.0 ? part.x : 1.0,
        y == -2.0 ? 1.0 - part.y : y == 3.0 ? part.y : 1.0);
      share += max(more, 0.0) * weight.x * weight.y;
    }
  return share / 25.0;
}

vec3 seen(vec2 pixel, int eye) {
  vec3 sum = vec3(0.0), faded = vec3(0.0);
  float share = unknown(pixel, eye);
  for (int k = 4 * eye; k < 4 * eye + 4; k++) {
    if (sights[k].y > 0.0) sum += sights[k].y * warped(pixel, sights[k], shift[eye]);
    if (share > 0.0) faded += fades[k].y
      * textureLod(views, vec3((pixel + 0.5 + fades[k].zw) / size, fades[k].x), 0.0).rgb;
  }
  return mix(sum, faded, share);
}

vec3 decoded(vec3 code) {
  return mix(code / 12.92, pow((code + 0.055) / 1.055, vec3(2.4)), step(0.04045, code));
}

vec3 encoded(vec3 light) {
  return mix(light * 12.92, 1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, light));
}

void main() {
  vec2 pixel = floor(at * size);
  vec3 eyes[2], first, second;
  for (int eye = 0; eye < 2; eye++) {
    eyes[eye] = seen(pixel, eye);
    if (linear.x) eyes[eye] = decoded(eyes[eye]);
  }
  for (int c = 0; c < 3; c++) {
    first[c] = clamp(dot(own[c].rgb, eyes[int(own[c].a)]), 0.0, 1.0);
    second[c] = clamp(dot(crossed[c].rgb, eyes[int(crossed[c].a)]), 0.0, 1.0);
  }
  if (linear.y && !linear.x) { first = decoded(first); second = decoded(second); }
  vec3 mixed = clamp(vec3(gains[0].x, gains[1].x, gains[2].x) * first
    + vec3(gains[0].y, gains[1].y, gains[2].y) * second, 0.0, 1.0);
  picture = vec4(linear.y ? encoded(mixed) : mixed, 1.0);
}
