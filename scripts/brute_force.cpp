// SPDX-FileCopyrightText: 2026 Scanstage Authors
// SPDX-License-Identifier: GPL-3.0-or-later
//
// The compiled brute force that scripts/benchmark.py measures against: every voxel's centre in every view, until a view
// sees it outside its silhouette (early exit), on all processors. It reads the projection matrices in half-voxel units,
// as addon/reconstruction/volumetric/silhouette_test.py rounds them, so that both give the same volume bit for bit.
//
//   g++ -O3 -march=native -ffp-contract=off -shared -fPIC -pthread brute_force.cpp -o brute_force.so

#include <atomic>
#include <cmath>
#include <cstdint>
#include <thread>
#include <vector>

namespace {

struct View {
  const double* matrix;      // 3x4, half voxels to pixels of a region: floor gives the pixel
  const int* corner;         // of the region in the picture: column, row
  const std::uint8_t* mask;  // height x width, not 0 inside
};

bool inside(const View& view, int width, int height, double x, double y, double z) {
  const double* m = view.matrix;
  const double inverse = 1.0 / (m[8] * x + m[9] * y + m[10] * z + m[11]);
  const int u = static_cast<int>(std::floor((m[0] * x + m[1] * y + m[2] * z + m[3]) * inverse)) + view.corner[0];
  const int v = static_cast<int>(std::floor((m[4] * x + m[5] * y + m[6] * z + m[7]) * inverse)) + view.corner[1];
  return u < 0 || v < 0 || u >= width || v >= height || view.mask[static_cast<std::size_t>(v) * width + u];
}

}  // namespace

extern "C" std::int64_t carve(const double* matrices, const int* corners, const std::uint8_t* masks, int views, int width, int height, int nx,
                              int ny, int nz, std::uint8_t* occupancy) {
  std::atomic<int> next{0};
  std::atomic<std::int64_t> kept{0};
  auto work = [&] {
    std::int64_t count = 0;
    for (int i; (i = next.fetch_add(1)) < nx;)
      for (int j = 0; j < ny; ++j) {
        std::uint8_t* row = occupancy + (static_cast<std::size_t>(i) * ny + j) * nz;
        for (int k = 0; k < nz; ++k) {
          bool keep = true;
          for (int n = 0; keep && n < views; ++n)
            keep = inside({matrices + 12 * n, corners + 2 * n, masks + static_cast<std::size_t>(n) * width * height}, width, height,
                          2 * i + 1, 2 * j + 1, 2 * k + 1);
          row[k] = keep;
          count += keep;
        }
      }
    kept += count;
  };
  std::vector<std::thread> threads(std::thread::hardware_concurrency());
  for (auto& thread : threads) thread = std::thread(work);
  for (auto& thread : threads) thread.join();
  return kept;
}

// What voxel coloring does at least: every voxel's centre projected into every view, and the pixel there (r, g, b, alpha) read.
extern "C" double project_and_gather(const double* matrices, const float* pictures, int views, int width, int height, int nx, int ny, int nz) {
  double total = 0;
  for (int n = 0; n < views; ++n) {
    const double* m = matrices + 12 * n;
    const float* picture = pictures + static_cast<std::size_t>(n) * width * height * 4;
    for (int i = 0; i < nx; ++i)
      for (int j = 0; j < ny; ++j)
        for (int k = 0; k < nz; ++k) {
          const double x = i + 0.5, y = j + 0.5, z = k + 0.5;
          const double inverse = 1.0 / (m[8] * x + m[9] * y + m[10] * z + m[11]);
          const int u = static_cast<int>((m[0] * x + m[1] * y + m[2] * z + m[3]) * inverse + 0.5);
          const int v = static_cast<int>((m[4] * x + m[5] * y + m[6] * z + m[7]) * inverse + 0.5);
          if (u < 0 || v < 0 || u >= width || v >= height) continue;
          const float* pixel = picture + (static_cast<std::size_t>(v) * width + u) * 4;
          total += pixel[0] + pixel[1] + pixel[2] + pixel[3];
        }
  }
  return total;
}
