// The yardstick of `rasterisers.py`: skinning, projection, z-buffer, Eq. 6 and Eq. 7 for many particles, as one would write
// them by hand for one core. Rows of 16 pixels where AVX-512 is there, single pixels elsewhere.
//
//   g++ -O3 -march=native -ffast-math -fno-finite-math-only -std=c++17 -shared -fPIC z_buffer.cpp -o z_buffer.so
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>
#ifdef __AVX512F__
#include <immintrin.h>
#endif

struct Edge {
  float a, b, c;
  float at(float x, float y) const { return a * x + b * y + c; }
};

static void draw(int count, const int* faces, const int* numbers, const float* screen, int height, int width, float* depth,
                 int* ids) {
  for (int f = 0; f < count; f++) {
    const float *p = screen + 3 * faces[3 * f], *q = screen + 3 * faces[3 * f + 1], *r = screen + 3 * faces[3 * f + 2];
    float area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    if (!(area < -1e-8f) || std::min({p[2], q[2], r[2]}) <= 0) continue;
    int x0 = std::max(0, (int)std::ceil(std::min({p[0], q[0], r[0]})));
    int x1 = std::min(width - 1, (int)std::floor(std::max({p[0], q[0], r[0]})));
    int y0 = std::max(0, (int)std::ceil(std::min({p[1], q[1], r[1]})));
    int y1 = std::min(height - 1, (int)std::floor(std::max({p[1], q[1], r[1]})));
    if (x0 > x1 || y0 > y1) continue;
    float inverse = 1 / area;
    Edge u{-(r[1] - q[1]) * inverse, (r[0] - q[0]) * inverse, 0}, v{-(p[1] - r[1]) * inverse, (p[0] - r[0]) * inverse, 0};
    u.c = -(u.a * q[0] + u.b * q[1]);
    v.c = -(v.a * r[0] + v.b * r[1]);
    float dp = p[2] - r[2], dq = q[2] - r[2];
    Edge z{u.a * dp + v.a * dq, u.b * dp + v.b * dq, u.c * dp + v.c * dq + r[2]};
    int number = numbers[f];
#ifdef __AVX512F__
    const __m512 lane = _mm512_setr_ps(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15), one = _mm512_set1_ps(1);
    auto row = [&](const Edge& e, __m512 x) { return _mm512_fmadd_ps(_mm512_set1_ps(e.a), x, _mm512_set1_ps(e.c)); };
    for (int x = x0; x <= x1; x += 16) {
      __m512 at = _mm512_add_ps(lane, _mm512_set1_ps((float)x)), eu = row(u, at), ev = row(v, at), ez = row(z, at);
      __mmask16 inside = x1 - x >= 15 ? 0xffff : (__mmask16)((1u << (x1 - x + 1)) - 1);
      for (int y = y0; y <= y1; y++) {
        __m512 down = _mm512_set1_ps((float)y);
        __m512 first = _mm512_fmadd_ps(_mm512_set1_ps(u.b), down, eu);
        __m512 second = _mm512_fmadd_ps(_mm512_set1_ps(v.b), down, ev);
        __m512 third = _mm512_sub_ps(_mm512_sub_ps(one, first), second);
        __m512 least = _mm512_min_ps(_mm512_min_ps(first, second), third);
        __mmask16 hit = _mm512_mask_cmp_ps_mask(inside, least, _mm512_setzero_ps(), _CMP_GE_OQ);
        if (!hit) continue;
        float* to = depth + (size_t)y * width + x;
        __m512 near = _mm512_fmadd_ps(_mm512_set1_ps(z.b), down, ez);
        hit = _mm512_mask_cmp_ps_mask(hit, near, _mm512_maskz_loadu_ps(hit, to), _CMP_GT_OQ);
        _mm512_mask_storeu_ps(to, hit, near);
        _mm512_mask_storeu_epi32(ids + (size_t)y * width + x, hit, _mm512_set1_epi32(number));
      }
    }
#else
    for (int y = y0; y <= y1; y++)
      for (int x = x0; x <= x1; x++) {
        float first = u.at(x, y), second = v.at(x, y);
        if (first < 0 || second < 0 || 1 - first - second < 0) continue;
        float near = z.at(x, y);
        size_t i = (size_t)y * width + x;
        if (near > depth[i]) depth[i] = near, ids[i] = number;
      }
#endif
  }
}

// What Eq. 7 needs of the whole rectangle (rows x columns) that holds the regions: packed colours and base ids (camera,
// row, column), corner (camera, 2) of the rectangle in the image and of the region in it, the pair table `near` (face,
// words), and per ordered pair (m, n) the homography and shift (pair, 12) that carry pixel and inverse depth to n.
struct Rectangle {
  int rows, columns, words;
  const int *packed, *base_id, *origin, *corner;
  const uint32_t* near;
  const float* between;
};

// Pixels of m outside the region whose partner in n lies in it: where, which face, at what cost if they meet.
struct Far {
  int count;
  const int *target, *face;
  const float* cost;
  float fixed_cost, fixed_count;
};

static bool meets(const Rectangle& all, int face, int other) {
  return other >= 0 && (all.near[(size_t)face * all.words + (other >> 5)] >> (other & 31)) & 1;
}

// The mean of Eq. 7 from view m to view n. A partner that is not near costs 1; colours between pixels are bilinear.
static double pair_mean(const Rectangle& all, const Far& far, int m, int n, const float* between, int height, int width,
                        const float* depth, const int* ids) {
  size_t pixels = (size_t)height * width, whole = (size_t)all.rows * all.columns;
  const float* from = depth + m * pixels;
  const int *own_ids = ids + m * pixels, *other_ids = ids + n * pixels, *base = all.base_id + n * whole;
  const int *own = all.packed + m * whole, *other = all.packed + n * whole;
  int top = all.corner[2 * m], left = all.corner[2 * m + 1], there_top = all.corner[2 * n], there_left = all.corner[2 * n + 1];
  double cost = far.fixed_cost, count = far.fixed_count;
  for (int y = 0; y < height; y++)
    for (int x = 0; x < width; x++) {
      int face = own_ids[(size_t)y * width + x];
      if (face < 0) continue;
      count++;
      float d = from[(size_t)y * width + x], q[3];
      float u = x + left + all.origin[2 * m + 1] + 0.5f, v = y + top + all.origin[2 * m] + 0.5f;
      for (int j = 0; j < 3; j++) q[j] = between[4 * j] * u + between[4 * j + 1] * v + between[4 * j + 2] + between[4 * j + 3] * d;
      float px = q[0] / q[2] - all.origin[2 * n + 1] - 0.5f, py = q[1] / q[2] - all.origin[2 * n] - 0.5f;
      if (!(q[2] > 1e-6f && px >= -0.5f && py >= -0.5f && px < all.columns - 0.5f && py < all.rows - 0.5f)) {
        cost++;
        continue;
      }
      int column = (int)std::nearbyint(px), row = (int)std::nearbyint(py), r = row - there_top, c = column - there_left;
      bool drawn = r >= 0 && c >= 0 && r < height && c < width;
      int found = drawn ? other_ids[(size_t)r * width + c] : base[(size_t)row * all.columns + column];
      if (!meets(all, face, found)) {
        cost++;
        continue;
      }
      px = std::min(std::max(px, 0.f), all.columns - 1.001f), py = std::min(std::max(py, 0.f), all.rows - 1.001f);
      int x0 = (int)px, y0 = (int)py;
      float fx = px - x0, fy = py - y0, square = 0;
      const int *at = other + (size_t)y0 * all.columns + x0, *down = at + all.columns;
      int mine = own[(size_t)(y + top) * all.columns + x + left];
      for (int shift = 0; shift < 24; shift += 8) {
        auto channel = [&](int packed) { return (float)((packed >> shift) & 255); };
        float high = channel(at[0]) * (1 - fx) + channel(at[1]) * fx, low = channel(down[0]) * (1 - fx) + channel(down[1]) * fx;
        float gap = channel(mine) - (high * (1 - fy) + low * fy);
        square += gap * gap;
      }
      cost += std::min(std::sqrt(square) / 255, 1.f);
    }
  for (int i = 0; i < far.count; i++) {
    count++;
    cost += meets(all, far.face[i], other_ids[far.target[i]]) ? far.cost[i] : 1;
  }
  return count > 0 ? cost / count : 1;
}

// Eq. 6 summed over the pixels of the region, per particle. Arrays as their names say, all dense and row by row:
// bones (particle, bone, 3, 4), vertices (vertex, 3), bone_index and bone_weight (vertex, 4), faces (face, 3),
// projection (camera, 3, 4), corner (camera, 2) of the region as row and column of the image, labels, background,
// uncovered, base_depth and base_id (camera, height, width), table (camera, all_faces, colours).
// ids (camera, height, width) are those of the last particle. With `all`, also Eq. 7 summed over the ordered pairs of two
// cameras, `far` per pair.
extern "C" void score(int particles, int bones_count, int vertex_count, int face_count, int cameras, int height, int width,
                      int all_faces, int colours, const float* bones, const float* vertices, const int* bone_index,
                      const float* bone_weight, const int* faces, const int* numbers, const float* projection,
                      const int* corner, const int* labels, const float* background, const float* uncovered,
                      const float* base_depth, const int* base_id, const float* table, float epsilon, double* out, int* ids, const Rectangle* all, const Far* far,
                      double* out_pairs) {
  size_t pixels = (size_t)height * width;
  std::vector<float> world(3 * vertex_count), screen(3 * vertex_count), depths(cameras * pixels + 16);
  for (int particle = 0; particle < particles; particle++) {
    const float* own = bones + (size_t)particle * bones_count * 12;
    for (int i = 0; i < vertex_count; i++) {
      float blend[12] = {0};
      for (int k = 0; k < 4; k++) {
        const float *bone = own + 12 * bone_index[4 * i + k], weight = bone_weight[4 * i + k];
        for (int j = 0; j < 12; j++) blend[j] += weight * bone[j];
      }
      const float* at = vertices + 3 * i;
      for (int j = 0; j < 3; j++)
        world[3 * i + j] = blend[4 * j] * at[0] + blend[4 * j + 1] * at[1] + blend[4 * j + 2] * at[2] + blend[4 * j + 3];
    }
    double total = 0;
    for (int camera = 0; camera < cameras; camera++) {
      const float* m = projection + 12 * camera;
      for (int i = 0; i < vertex_count; i++) {
        float q[3];
        for (int j = 0; j < 3; j++)
          q[j] = m[4 * j] * world[3 * i] + m[4 * j + 1] * world[3 * i + 1] + m[4 * j + 2] * world[3 * i + 2] + m[4 * j + 3];
        float inverse = q[2] > 1e-3f ? 1 / q[2] : -1;
        screen[3 * i] = q[0] * std::fabs(inverse) - (corner[2 * camera + 1] + 0.5f);
        screen[3 * i + 1] = q[1] * std::fabs(inverse) - (corner[2 * camera] + 0.5f);
        screen[3 * i + 2] = inverse;
      }
      int* seen = ids + camera * pixels;
      float* depth = depths.data() + camera * pixels;
      std::memcpy(depth, base_depth + camera * pixels, 4 * pixels);
      std::memcpy(seen, base_id + camera * pixels, 4 * pixels);
      draw(face_count, faces, numbers, screen.data(), height, width, depth, seen);
      const float *own_table = table + (size_t)camera * all_faces * colours, *behind = background + camera * pixels;
      const float* bare = uncovered + camera * pixels;
      const int* label = labels + camera * pixels;
      float sum[16] = {0};
      for (size_t i = 0; i < pixels; i++) {
        float psi = own_table[(size_t)std::max(seen[i], 0) * colours + label[i]];
        sum[i % 16] += seen[i] >= 0 ? (psi + epsilon) / (psi + behind[i] + 2 * epsilon) : bare[i];
      }
      for (float part : sum) total += part;
    }
    out[particle] = total;
    if (all) {
      out_pairs[particle] = 0;
      for (int m = 0; m < 2; m++)
        out_pairs[particle] += pair_mean(*all, far[m], m, 1 - m, all->between + 12 * m, height, width, depths.data(), ids);
    }
  }
}
