//===- VectorMathTest.cpp - Elementary functions in loops -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Loops call vector forms of functions where the processor and its libraries
// have them. Results are compared with libm in a wider float.
//
//===----------------------------------------------------------------------===//

#include "../../Utils/EngineTestUtil.h"
#include "tai/CodeGen/ObjectCompiler.h"
#include "llvm/ADT/STLExtras.h"
#include "llvm/ADT/bit.h"
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

using namespace tai_test;

namespace {
struct Function {
  const char *name;
  long double (*exact)(long double);
  double least, most;
};

const Function functions[] = {
    {"sin", sinl, -1e6, 1e6},   {"cos", cosl, -1e6, 1e6},
    {"tan", tanl, -30, 30},     {"asin", asinl, -1, 1},
    {"acos", acosl, -1, 1},     {"atan", atanl, -30, 30},
    {"exp", expl, -80, 80},     {"exp2", exp2l, -120, 120},
    {"expm1", expm1l, -20, 20}, {"log", logl, 0, 9},
    {"log2", log2l, 0, 9},      {"log10", log10l, 0, 9},
    {"log1p", log1pl, -1, 9},   {"sinh", sinhl, -20, 20},
    {"cosh", coshl, -20, 20},   {"tanh", tanhl, -9, 9},
    {"asinh", asinhl, -30, 30}, {"acosh", acoshl, 1, 30},
    {"atanh", atanhl, -1, 1},   {"cbrt", cbrtl, -30, 30},
    {"erf", erfl, -3, 3}};

/// The results of the function for each element of `x`, computed in a loop.
template <typename T>
std::vector<T> map(const std::string &name, const std::vector<T> &x,
                   const char *option = nullptr, const char *value = nullptr,
                   const std::vector<T> *y = nullptr) {
  Context context;
  if (option)
    context.set(option, value);
  std::string type = sizeof(T) == 8 ? "f64" : "f32";
  std::string shape = "<[i: " + std::to_string(x.size()) + "], {";
  std::string tree = "!tai.root<dense" + shape + "x: " + type + "}>, dense" +
                     shape + "y: " + type + "}>, dense" + shape + "z: " + type +
                     "}>>";
  context.ok(taiContextAddTree(context, "t", tree.c_str()));
  auto add = [&](std::string name) {
    return context.field(("tai.field @" + name + " = @t[\"" + name +
                          "\"] : " + type + ", rank 1")
                             .c_str());
  };
  TaiField fx = add("x"), fy = add("y"), fz = add("z");
  TaiKernel kernel = context.kernel(
      "k", "tai.kernel @k() {\n"
           "  tai.parallel_for (%i) in @x {\n"
           "    %x = tai.load @x[%i] : " +
               type + "\n    %y = tai.load @y[%i] : " + type +
               "\n    %z = math." + name + " %x" + (y ? ", %y" : "") + " : " +
               type + "\n    tai.store %z, @z[%i] : " + type +
               "\n  }\n  tai.return\n}\n");
  context.ok(taiFieldCopyFromHost(fx, x.data()));
  if (y)
    context.ok(taiFieldCopyFromHost(fy, y->data()));
  if (kernel)
    context.ok(taiKernelLaunch(kernel, nullptr, 0, nullptr));
  std::vector<T> z(x.size());
  context.ok(taiFieldCopyToHost(fz, z.data()));
  return z;
}

/// The distance from the exact number rounded to T, in units in the last place;
/// 0 if both are the same infinity, zero or NaN.
template <typename T> double distance(T found, long double exact) {
  T nearest = static_cast<T>(exact);
  if (std::isnan(nearest) || std::isinf(nearest) || nearest == 0) {
    bool same =
        std::isnan(nearest)
            ? std::isnan(found)
            : found == nearest && std::signbit(found) == std::signbit(nearest);
    return same ? 0 : std::numeric_limits<double>::infinity();
  }
  int exponent =
      std::max(std::ilogb(nearest), std::numeric_limits<T>::min_exponent - 1);
  return std::fabs(static_cast<double>(
      (found - exact) /
      ldexpl(1, exponent - std::numeric_limits<T>::digits + 1)));
}

template <typename T> std::vector<T> makeArguments(double least, double most) {
  std::mt19937 random(7);
  std::vector<T> x;
  for (int i = 0; i < 4000; ++i) {
    T value = std::uniform_real_distribution<T>(least, most)(random);
    x.push_back(value);
    // Add numbers of all magnitudes.
    x.push_back(std::ldexp(value, -int(random() % 100)));
  }
  // Special numbers are placed among ordinary numbers, in the same vector.
  using Limits = std::numeric_limits<T>;
  T special[] = {0, -T(0), 1, -1, Limits::infinity(), -Limits::infinity(),
                 Limits::quiet_NaN(), Limits::denorm_min(),
                 -Limits::denorm_min(), Limits::min(), Limits::min() / 3,
                 Limits::max(), -Limits::max(), T(1e30), T(-12345678),
                 // Next to the ends of exponentials, and beyond.
                 T(88.9), T(-89.2), T(103.5), T(710.1), T(-710.4)};
  size_t at = 5;
  for (T value : special)
    x[at += 11] = value;
  return x;
}

bool hasVectorForms() {
  return llvm::is_contained(mlir::tai::getVectorLibraries(), "libsleef.so.3") &&
         __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
}

template <typename T>
void expectAccurate(const char *option, const char *mode) {
  for (const Function &function : functions) {
    std::vector<T> x = makeArguments<T>(function.least, function.most);
    std::vector<T> y = map<T>(function.name, x, option, mode);
    double worst = 0;
    T where = 0;
    for (size_t i = 0; i < x.size(); ++i)
      if (double off = distance(y[i], function.exact(x[i])); off > worst) {
        worst = off;
        where = x[i];
      }
    // Functions of libm are off by up to three units; these functions have no
    // other form.
    std::string name = function.name;
    bool isHyperbolic = name == "sinh" || name == "cosh";
    bool isOfLibm = !hasVectorForms() || (isHyperbolic && sizeof(T) == 8) ||
                    llvm::is_contained({"asinh", "acosh", "atanh"}, name);
    bool isAccurate = std::string("accurate") == mode;
    EXPECT_LE(worst, isOfLibm && !isAccurate ? 3.0 : 1.0)
        << function.name << " of " << where << ", " << mode;
  }
}

TEST(VectorMath, FunctionsOfF32AreWithinOneUnit) {
  expectAccurate<float>("math", "default");
}
TEST(VectorMath, FunctionsOfF64AreWithinOneUnit) {
  expectAccurate<double>("math", "default");
}
TEST(VectorMath, DeterministicFunctionsOfF32AreWithinOneUnit) {
  expectAccurate<float>("deterministic", "true");
}
TEST(VectorMath, DeterministicFunctionsOfF64AreWithinOneUnit) {
  expectAccurate<double>("deterministic", "true");
}
TEST(VectorMath, AccurateFunctionsOfF32AreWithinOneUnit) {
  expectAccurate<float>("math", "accurate");
}
TEST(VectorMath, AccurateFunctionsOfF64AreWithinOneUnit) {
  expectAccurate<double>("math", "accurate");
}

template <typename T>
void expectAccuratePairs(const char *name,
                         long double (*exact)(long double, long double)) {
  std::vector<T> x = makeArguments<T>(-4, 40), y = makeArguments<T>(-9, 9);
  // Pair each special number with others.
  std::rotate(y.begin(), y.begin() + 22, y.end());
  std::vector<T> z = map<T>(name, x, nullptr, nullptr, &y);
  for (size_t i = 0; i < x.size(); ++i)
    EXPECT_LE(distance(z[i], exact(x[i], y[i])), 1.0)
        << name << " of " << x[i] << ", " << y[i];
}

TEST(VectorMath, FunctionsOfTwoNumbersAreWithinOneUnit) {
  expectAccuratePairs<float>("powf", powl);
  expectAccuratePairs<double>("powf", powl);
  expectAccuratePairs<double>("atan2", atan2l);
  if (hasVectorForms())
    expectAccuratePairs<float>("atan2", atan2l);
}

/// The result for an element must not depend on its place in a loop, on the
/// length of the loop, or on the processor's vectors.
template <typename T> void expectSameBits(const char *deterministic) {
  std::vector<T> x = makeArguments<T>(-1, 1);
  x.resize(1031);
  for (const Function &function : functions) {
    std::vector<T> all =
        map<T>(function.name, x, "deterministic", deterministic);
    if (hasVectorForms() && std::string("false") == deterministic) {
      std::vector<T> narrow =
          map<T>(function.name, x, "target_cpu", "x86-64-v3");
      EXPECT_TRUE(llvm::equal(all, narrow, [](T a, T b) {
        return distance<T>(a, b) == 0;
      })) << function.name;
    }
    for (size_t shift : {1, 2, 7, 15, 33}) {
      std::vector<T> rest(x.begin() + shift, x.end());
      std::vector<T> found =
          map<T>(function.name, rest, "deterministic", deterministic);
      for (size_t i = 0; i < rest.size(); ++i)
        ASSERT_EQ(distance<T>(found[i], all[i + shift]), 0)
            << function.name << " of " << rest[i] << " at " << i;
    }
  }
}

TEST(VectorMath, BitsOfF32DoNotDependOnThePlace) {
  expectSameBits<float>("false");
}
TEST(VectorMath, BitsOfF64DoNotDependOnThePlace) {
  expectSameBits<double>("false");
}
TEST(VectorMath, DeterministicBitsOfF32DoNotDependOnThePlace) {
  expectSameBits<float>("true");
}

/// Checks loops of f64 against `exact`, within `most` units in the last place.
void expectWithin(const char *name, long double (*exact)(long double),
                  const std::vector<double> &x, double most) {
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma"))
    GTEST_SKIP() << "the processor has no vector forms";
  for (const char *cpu : {"", "x86-64-v3"}) {
    std::vector<double> y =
        *cpu ? map<double>(name, x, "target_cpu", cpu) : map<double>(name, x);
    for (size_t i = 0; i < x.size(); ++i)
      ASSERT_LE(distance<double>(y[i], exact(x[i])), most)
          << name << " of " << x[i] << " on " << cpu;
  }
}

/// Angles where sines of f64 lose most, and where one reduction follows
/// another.
std::vector<double> makeAngles() {
  std::mt19937_64 random(11);
  std::vector<double> x;
  for (int i = 0; i < 20000; ++i) {
    // Quarter turns are the zeros of sine and cosine, eighths the ends of the
    // polynomials.
    double eighths = std::ldexp(static_cast<double>(random() >> 11),
                                -53 + static_cast<int>(random() % 41));
    double angle = static_cast<double>(std::floor(eighths) * M_PI_4l);
    x.push_back(random() % 2 ? angle : -angle);
    x.push_back(std::nextafter(angle, random() % 2 ? 1e300 : -1e300));
  }
  for (double border : {0x1p20, 0x1p40})
    for (int i = -500; i < 500; ++i)
      x.push_back((i % 2 ? border : -border) * (1 + i * 0x1p-52));
  return x;
}

TEST(VectorMath, SinesOfF64HoldNextToQuarterTurnsAndBorders) {
  expectWithin("sin", sinl, makeAngles(), 0.62);
}
TEST(VectorMath, CosinesOfF64HoldNextToQuarterTurnsAndBorders) {
  expectWithin("cos", cosl, makeAngles(), 0.62);
}

TEST(VectorMath, ExponentialsOfF64HoldUpToTheEndsOfTheRange) {
  std::mt19937_64 random(12);
  auto uniform = [&](double least, double most) {
    return std::uniform_real_distribution<double>(least, most)(random);
  };
  std::vector<double> normal, tiny;
  for (int i = 0; i < 20000; ++i) {
    normal.push_back(uniform(-708.3, 709.8));
    normal.push_back(uniform(707.9, 709.8));
    tiny.push_back(uniform(-746, -707.9));
  }
  // The last finite result and the first infinite one.
  normal.insert(normal.end(), {709.782712893384, 709.7827128933841});
  tiny.insert(tiny.end(), {-745.1332191019411, -745.1332191019412, -1e300});
  expectWithin("exp", expl, normal, 0.7);
  expectWithin("exp", expl, tiny, 0.8);
}

TEST(VectorMath, StrictKernelsCallLibm) {
  std::vector<double> x = makeArguments<double>(-30, 30);
  std::vector<double> y = map<double>("sin", x, "math", "strict");
  for (size_t i = 0; i < x.size(); ++i)
    EXPECT_EQ(distance<double>(y[i], sin(x[i])), 0) << x[i];
}
} // namespace
