#include "host/boxes.h"

#include "host/parallel.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

namespace drsplat {

namespace {

constexpr double kPrecision = 1e-7;  // of the range of a set
constexpr int kSteps = 100;          // of which it needs less than 20
constexpr double kPi = 3.14159265358979323846, kRootOfHalf = 0.70710678118654752440;
constexpr int kSweeps = 30;  // of Jacobi's rotations, of which it needs less than ten
constexpr int kRounds = 2;   // of leaving strays out
constexpr int kTails = 13;   // shares of the mass that a tail may have: none, and steps of one factor up to the largest
constexpr size_t kFewest = 4;  // points: fewer have no axes in space
constexpr double kTailStep = 0.77;
constexpr size_t kSample = 256;

using Vector3 = std::array<double, 3>;
using Matrix3 = std::array<Vector3, 3>;  // by rows

double dot(const Vector3 &x, const Vector3 &y) { return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]; }

Vector3 cross(const Vector3 &x, const Vector3 &y) {
  return {x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]};
}

// Turns the plane of axes p and q so that `spread`, a matrix along the axes, has no part off its diagonal there.
void turn(Matrix3 &spread, Matrix3 &axes, int p, int q) {
  if (spread[p][q] == 0) return;
  const double angle = 0.5 * std::atan2(2 * spread[p][q], spread[p][p] - spread[q][q]);
  const double c = std::cos(angle), s = std::sin(angle);
  for (Matrix3 *rows : {&spread, &axes})
    for (int k = 0; k < 3; k++) {
      const double x = (*rows)[p][k], y = (*rows)[q][k];
      (*rows)[p][k] = c * x + s * y, (*rows)[q][k] = c * y - s * x;
    }
  for (int k = 0; k < 3; k++) {
    const double x = spread[k][p], y = spread[k][q];
    spread[k][p] = c * x + s * y, spread[k][q] = c * y - s * x;
  }
  spread[p][q] = spread[q][p] = 0;
}

// Each of `axes` in the coordinates of what a unit quaternion turns.
Matrix3 turned_to(const float *quat, const Matrix3 &axes) {
  const double w = quat[0], x = quat[1], y = quat[2], z = quat[3];
  const Matrix3 columns{{{1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)},
                         {2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)},
                         {2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)}}};
  Matrix3 turned;
  for (int k = 0; k < 3; k++)
    for (int j = 0; j < 3; j++) turned[k][j] = dot(axes[k], columns[j]);
  return turned;
}

// The normal distribution, interpolated (to 2e-10) between a few of its values and slopes.
struct Normal {
  static constexpr int kFar = 6, kEach = 64, kCount = 2 * kFar * kEach;
  double values[kCount + 2], slopes[kCount + 2];

  Normal() {
    for (int i = 0; i < kCount + 2; i++) {
      const double z = (double)i / kEach - kFar;
      values[i] = std::erfc(-z * kRootOfHalf) / 2;
      slopes[i] = std::exp(-z * z / 2) * kRootOfHalf / std::sqrt(kPi) / kEach;
    }
  }

  double below(double z) const {
    if (!(z > -kFar)) return 0;
    if (z >= kFar) return 1;
    const double at = (z + kFar) * kEach;
    const int i = (int)at;
    const double t = at - i, rise = values[i + 1] - values[i];
    return values[i] + t * (slopes[i] + t * (3 * rise - 2 * slopes[i] - slopes[i + 1] +
                                             t * (slopes[i] + slopes[i + 1] - 2 * rise)));
  }
};

const Normal kNormal;

// Shares of the mass that a tail may have, and for what is left without two of them the power of its mass, as a
// logarithm.
struct Tails {
  std::array<double, kTails> shares;
  std::array<std::array<double, kTails>, kTails> left;

  explicit Tails(const BoxRule &rule) {
    for (int i = 0; i < kTails; i++) shares[i] = i ? rule.strays * std::pow(kTailStep, kTails - 1 - i) : 0;
    for (int i = 0; i < kTails; i++)
      for (int j = 0; j < kTails; j++) left[i][j] = rule.sparse * std::log(1 - shares[i] - shares[j]);
  }
};

// One set's Gaussians along the axes of its box.
struct Set {
  std::vector<Vector3> points, along, deviations;
  std::vector<double> mass, near, widths, masses, some;
  std::vector<char> inside;
  std::vector<std::pair<double, double>> beyond;

  void take(const Solids &all, const int64_t *ids, size_t count) {
    points.resize(count), mass.resize(count), along.resize(count), deviations.resize(count);
    inside.assign(count, 1);
    double total = 0;
    for (size_t i = 0; i < count; i++) {
      const float *point = all.means + 3 * ids[i];
      points[i] = {point[0], point[1], point[2]}, mass[i] = all.mass[ids[i]], total += mass[i];
    }
    for (double &m : mass) m = total > 0 ? m / total : 1.0 / (double)count;
  }

  // The principal axes of those inside; of an upright box those in the plane, and up.
  Matrix3 axes_of_inside(const double *up) const {
    Matrix3 axes{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    if (up) {
      const Vector3 direction{up[0], up[1], up[2]};
      const auto less = [](double x, double y) { return std::abs(x) < std::abs(y); };
      const auto least = std::min_element(direction.begin(), direction.end(), less) - direction.begin();
      axes[0] = cross(direction, axes[(size_t)least]);
      const double length = std::sqrt(dot(axes[0], axes[0]));
      for (double &x : axes[0]) x /= length;
      axes[1] = cross(direction, axes[0]), axes[2] = direction;
    }
    Matrix3 spread = spread_along(axes);
    turn(spread, axes, 0, 1);
    for (int sweep = 0; !up && sweep < kSweeps; sweep++)
      turn(spread, axes, 0, 2), turn(spread, axes, 1, 2), turn(spread, axes, 0, 1);
    return axes;
  }

  Matrix3 spread_along(const Matrix3 &axes) const {
    Vector3 middle{};
    double total = 0;
    for (size_t i = 0; i < points.size(); i++)
      if (inside[i]) {
        total += mass[i];
        for (int k = 0; k < 3; k++) middle[k] += mass[i] * points[i][k];
      }
    for (double &x : middle) x /= total;
    Matrix3 spread{};
    for (size_t i = 0; i < points.size(); i++) {
      if (!inside[i]) continue;
      const Vector3 off{points[i][0] - middle[0], points[i][1] - middle[1], points[i][2] - middle[2]};
      const Vector3 own{dot(axes[0], off), dot(axes[1], off), dot(axes[2], off)};
      for (int j = 0; j < 3; j++)
        for (int k = 0; k < 3; k++) spread[j][k] += mass[i] * own[j] * own[k];
    }
    return spread;
  }

  void lay_along(const Solids &all, const int64_t *ids, const Matrix3 &axes) {
    for (size_t i = 0; i < points.size(); i++) {
      const Matrix3 turned = turned_to(all.quats + 4 * ids[i], axes);
      const float *scales = all.scales + 3 * ids[i];
      for (int k = 0; k < 3; k++) {
        const Vector3 own{scales[0] * turned[k][0], scales[1] * turned[k][1], scales[2] * turned[k][2]};
        along[i][k] = dot(axes[k], points[i]), deviations[i][k] = std::sqrt(dot(own, own));
      }
    }
  }

  // Below which value, along an axis in the direction of `sign`, the share of the mass lies: by regula falsi
  // (Illinois) and bisection in turn, in which those that are all above or all below what is left of the range are left
  // out.
  double end(int axis, double sign, const BoxRule &rule) {
    double low = std::numeric_limits<double>::infinity(), high = -low, below = 0;
    for (size_t i = 0; i < points.size(); i++) {
      const double mean = sign * along[i][axis];
      low = std::min(low, mean - Normal::kFar * deviations[i][axis]), high = std::max(high, mean);
    }
    const double least = 1e-12 * (high - low) + std::numeric_limits<double>::min();
    near.clear(), widths.clear(), masses.clear();
    for (size_t i = 0; i < points.size(); i++)
      near.push_back(sign * along[i][axis]), widths.push_back(std::max(deviations[i][axis], least)),
          masses.push_back(mass[i]);
    const double enough = kPrecision * (high - low);
    double at_low = -rule.outliers, at_high = 1;  // by how much the share is missed, or more
    int kept = 0;                                 // which end was kept by the last step

    for (int step = 0; step < kSteps && high - low > enough; step++) {
      const bool halve = step < 4 || step % 4 == 0;
      const double value = halve ? (low + high) / 2 : (low * at_high - high * at_low) / (at_high - at_low);
      const double missed = below + mass_below(value) - rule.outliers;
      if (missed < 0) {
        low = value, at_low = missed;
        if (kept > 0) at_high /= 2;
        kept = 1;
      } else {
        high = value, at_high = missed;
        if (kept < 0) at_low /= 2;
        kept = -1;
      }
      below += drop(low, high);
    }
    return sign * (low + high) / 2;
  }

  double mass_below(double value) const {
    double sum = 0;
    for (size_t i = 0; i < near.size(); i++) sum += masses[i] * kNormal.below((value - near[i]) / widths[i]);
    return sum;
  }

  // Leaves out what is no more to be asked; the mass of those below.
  double drop(double low, double high) {
    size_t kept = 0;
    double below = 0;
    for (size_t i = 0; i < near.size(); i++) {
      if (near[i] + Normal::kFar * widths[i] <= low) below += masses[i];
      else if (near[i] - Normal::kFar * widths[i] < high)
        near[kept] = near[i], widths[kept] = widths[i], masses[kept++] = masses[i];
    }
    near.resize(kept), widths.resize(kept), masses.resize(kept);
    return below;
  }

  // Marks as inside what is in the core along each axis. Axes of everything may be turned by strays, so that a second
  // round has better ones.
  Matrix3 leave_strays_out(const BoxRule &rule, const Tails &tails) {
    for (int round = 0; round < kRounds; round++) {
      const Matrix3 axes = axes_of_inside(rule.up);
      for (size_t i = 0; i < points.size(); i++)
        for (int k = 0; k < 3; k++) along[i][k] = dot(axes[k], points[i]);
      inside.assign(points.size(), 1);
      for (int k = 0; k < 3; k++) {
        const auto [low, high] = core(k, tails);
        for (size_t i = 0; i < points.size(); i++) inside[i] &= along[i][k] >= low && along[i][k] <= high;
      }
      size_t left = 0;
      for (size_t i = 0; i < points.size(); i++) left += inside[i] && mass[i] > 0;
      if (left < kFewest) inside.assign(points.size(), 1);
    }
    return axes_of_inside(rule.up);
  }

  // The interval between the centres of two tails that has the largest mass^sparse / length.
  std::pair<double, double> core(int axis, const Tails &tails) {
    const auto lows = tail(axis, 1, tails), highs = tail(axis, -1, tails);
    const double least = 1e-9 * (highs[0] - lows[0]) + std::numeric_limits<double>::min();
    double best = -std::numeric_limits<double>::infinity();
    std::pair<double, double> ends{lows[0], highs[0]};
    for (int i = 0; i < kTails; i++)
      for (int j = 0; j < kTails; j++) {
        const double value = tails.left[i][j] - std::log(std::max(highs[j] - lows[i], least));
        if (highs[j] >= lows[i] && value > best) best = value, ends = {lows[i], highs[j]};
      }
    return ends;
  }

  // The centres along an axis with more than each of some shares of the mass on their side of `sign`, itself included.
  std::array<double, kTails> tail(int axis, double sign, const Tails &tails) {
    collect_beyond(axis, sign, tails);
    std::array<double, kTails> ends;
    double below = 0, at = 0;
    int found = 0;
    for (size_t i = 0; found < kTails && i < beyond.size(); i++) {
      at = -sign * beyond[i].first, below += beyond[i].second;
      while (found < kTails && below > tails.shares[(size_t)found]) ends[(size_t)found++] = at;
    }
    while (found < kTails) ends[(size_t)found++] = at;
    return ends;
  }

  // The outermost first. Of many only those beyond a centre that some tell, if they have the mass of the largest tail:
  // of the others nobody asks the order.
  void collect_beyond(int axis, double sign, const Tails &tails) {
    const auto value = [&](size_t i) { return -sign * along[i][(size_t)axis]; };
    double least = -std::numeric_limits<double>::infinity(), sum = 0;
    const size_t told = points.size() > 4 * kSample ? kSample : points.size(), last = told / 12;
    some.resize(told);
    for (size_t i = 0; i < told; i++) some[i] = value(i * points.size() / told);
    std::nth_element(some.begin(), some.begin() + (ptrdiff_t)last, some.end(), std::greater<>());
    if (last) least = some[last];
    for (bool enough = false; !enough; least = -std::numeric_limits<double>::infinity()) {
      beyond.clear(), sum = 0;
      for (size_t i = 0; i < points.size(); i++)
        if (value(i) >= least) beyond.push_back({value(i), mass[i]}), sum += mass[i];
      enough = sum > 2 * tails.shares.back() || std::isinf(least);  // then those left out are no numbers
    }
    std::sort(beyond.begin(), beyond.end(), std::greater<>());
  }

  void drop_strays(std::vector<int64_t> &ids) {
    size_t kept = 0;
    double total = 0;
    for (size_t i = 0; i < points.size(); i++)
      if (inside[i]) points[kept] = points[i], mass[kept] = mass[i], ids[kept++] = ids[i], total += mass[i];
    points.resize(kept), mass.resize(kept), ids.resize(kept), along.resize(kept), deviations.resize(kept);
    for (double &m : mass) m /= total;
  }
};

// The first two or three axes by length, each towards where its largest part is positive; right-handed.
void order(Matrix3 &axes, Vector3 &low, Vector3 &high, bool upright) {
  std::array<int, 3> by{0, 1, 2};
  std::stable_sort(by.begin(), by.begin() + (upright ? 2 : 3),
                   [&](int x, int y) { return high[x] - low[x] > high[y] - low[y]; });
  const Matrix3 a = axes;
  const Vector3 l = low, h = high;
  const auto set = [&](int k, int from, bool turned) {
    for (int j = 0; j < 3; j++) axes[k][j] = turned ? -a[from][j] : a[from][j];
    low[k] = turned ? -h[from] : l[from], high[k] = turned ? -l[from] : h[from];
  };
  const auto less = [](double x, double y) { return std::abs(x) < std::abs(y); };
  const auto points_back = [&](int from) { return *std::max_element(a[from].begin(), a[from].end(), less) < 0; };
  for (int k = 0; k < 3; k++) set(k, by[k], !(upright && k == 2) && points_back(by[k]));
  if (dot(cross(axes[0], axes[1]), axes[2]) >= 0) return;
  const int flip = upright ? 1 : 2;
  set(flip, by[flip], !points_back(by[flip]));
}

}  // namespace

void boxes(const Solids &all, const int64_t *starts, const int64_t *ids, uint64_t sets, const BoxRule &rule,
           int threads, double *centers, double *axes, double *lengths) {
  const Tails tails(rule);
  over_rows(sets, 1, threads, [&](int, uint64_t s, uint64_t) {
    Set set;
    Vector3 low, high;
    std::vector<int64_t> members(ids + starts[s], ids + starts[s + 1]);
    set.take(all, members.data(), members.size());
    Matrix3 own = set.leave_strays_out(rule, tails);
    set.drop_strays(members);
    set.lay_along(all, members.data(), own);
    for (int k = 0; k < 3; k++) low[k] = set.end(k, 1, rule), high[k] = set.end(k, -1, rule);
    order(own, low, high, rule.up != nullptr);
    for (int k = 0; k < 3; k++) {
      centers[3 * s + k] = 0, lengths[3 * s + k] = high[k] - low[k];
      std::copy_n(own[k].begin(), 3, axes + 9 * s + 3 * k);
      for (int j = 0; j < 3; j++) centers[3 * s + k] += (low[j] + high[j]) / 2 * own[j][k];
    }
  });
}

}  // namespace drsplat
