//===- AggregateAtomicsTest.cpp - Combined additions of a warp ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Runs the code for the threads of a warp in lockstep, and compares the sums in
// memory with sums added one by one.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/AggregateAtomics.h"
#include "../../Utils/LLVMPassUtils.h"
#include "tai/ABI/DeviceAccesses.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/IR/Instructions.h"
#include "llvm/IR/IntrinsicInst.h"
#include "llvm/IR/IntrinsicsNVPTX.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Verifier.h"
#include "llvm/MC/TargetRegistry.h"
#include "llvm/Support/SourceMgr.h"
#include "llvm/Support/TargetSelect.h"
#include "llvm/Target/TargetMachine.h"
#include "gtest/gtest.h"
#include <array>
#include <map>

using namespace llvm;
using namespace mlir::tai;

namespace {
constexpr unsigned warp = 32;
/// A value in each thread; doubles represent the floats of these tests exactly.
using Values = std::array<double, warp>;

/// The threads of a warp in lockstep. Interprets the instructions that the pass
/// emits.
struct Warp {
  std::map<const Value *, Values> values;
  std::map<std::string, double> memory;
  unsigned additions = 0, exchanges = 0;

  Values get(const Value *value) {
    Values result;
    if (auto *number = dyn_cast<ConstantInt>(value))
      result.fill(static_cast<double>(number->getZExtValue()));
    else if (auto *number = dyn_cast<ConstantFP>(value))
      result.fill(number->getValueAPF().convertToFloat());
    else
      result = values.at(value);
    return result;
  }

  static uint32_t bits(double value) { return static_cast<uint32_t>(value); }

  double evaluate(const Instruction &at, unsigned lane, uint32_t active) {
    auto operand = [&](unsigned i) { return get(at.getOperand(i))[lane]; };
    if (auto *call = dyn_cast<IntrinsicInst>(&at)) {
      Values given =
          call->arg_size() > 1 ? get(call->getArgOperand(1)) : Values();
      unsigned distance =
          call->arg_size() > 2 ? bits(get(call->getArgOperand(2))[lane]) : 0;
      // A value from an inactive thread is undefined.
      auto from = [&](unsigned other) {
        return other < warp && (active >> other & 1) ? given[other] : 12345.0;
      };
      switch (call->getIntrinsicID()) {
      case Intrinsic::nvvm_match_all_sync_i64p:
        EXPECT_EQ(bits(get(call->getArgOperand(0))[lane]), active);
        // The second part of the result, the only one that is used.
        for (unsigned other = 0; other < warp; ++other)
          if ((active >> other & 1) && given[other] != given[lane])
            return 0;
        return 1;
      case Intrinsic::nvvm_activemask:
        return active;
      case Intrinsic::nvvm_read_ptx_sreg_laneid:
        return lane;
      case Intrinsic::nvvm_shfl_sync_bfly_f32:
        EXPECT_EQ(bits(get(call->getArgOperand(0))[lane]), active);
        return from(lane ^ distance);
      case Intrinsic::nvvm_shfl_sync_down_f32:
        EXPECT_EQ(bits(get(call->getArgOperand(0))[lane]), active);
        return lane + distance < warp ? from(lane + distance) : given[lane];
      default:
        ADD_FAILURE() << "an intrinsic that is not known";
        return 0;
      }
    }
    if (isa<SelectInst>(&at))
      return operand(0) != 0 ? operand(1) : operand(2);
    if (auto *compare = dyn_cast<ICmpInst>(&at)) {
      switch (compare->getPredicate()) {
      case CmpInst::ICMP_EQ:
        return operand(0) == operand(1);
      case CmpInst::ICMP_NE:
        return operand(0) != operand(1);
      default:
        EXPECT_EQ(compare->getPredicate(), CmpInst::ICMP_ULT);
        return operand(0) < operand(1);
      }
    }
    // A pointer is the number of its parameter; no test has offsets.
    if (isa<GetElementPtrInst>(at)) {
      EXPECT_EQ(operand(1), 0);
      return operand(0);
    }
    switch (at.getOpcode()) {
    // A pointer in memory is the number of its place.
    case Instruction::Load:
    case Instruction::PtrToInt:
    case Instruction::ExtractValue:
      return operand(0);
    case Instruction::FAdd:
      return operand(0) + operand(1);
    case Instruction::Add:
      return bits(operand(0)) + bits(operand(1));
    case Instruction::And:
      return bits(operand(0)) & bits(operand(1));
    case Instruction::Or:
      return bits(operand(0)) | bits(operand(1));
    case Instruction::LShr:
      return bits(operand(0)) >> bits(operand(1));
    default:
      ADD_FAILURE() << "an operation that is not known";
      return 0;
    }
  }

  void run(const BasicBlock &block, uint32_t active,
           const std::vector<std::string> &names) {
    for (const Instruction &at : block) {
      if (isa<ReturnInst>(at) || active == 0)
        return;
      if (auto *branch = dyn_cast<BranchInst>(&at)) {
        if (!branch->isConditional())
          return run(*branch->getSuccessor(0), active, names);
        Values condition = get(branch->getCondition());
        uint32_t taken = 0;
        for (unsigned lane = 0; lane < warp; ++lane)
          if (condition[lane] != 0)
            taken |= active & uint32_t(1) << lane;
        run(*branch->getSuccessor(0), taken, names);
        return run(*branch->getSuccessor(1), active & ~taken, names);
      }
      Values result{};
      for (unsigned lane = 0; lane < warp; ++lane) {
        if (!(active >> lane & 1))
          continue;
        if (auto *op = dyn_cast<AtomicRMWInst>(&at)) {
          // A pointer is the number of its parameter.
          memory[names[bits(get(op->getPointerOperand())[lane])]] +=
              get(op->getValOperand())[lane];
          ++additions;
        } else {
          result[lane] = evaluate(at, lane, active);
        }
      }
      if (auto *call = dyn_cast<IntrinsicInst>(&at))
        exchanges += call->arg_size() > 2;
      values[&at] = result;
    }
  }
};

/// The properties of the elements that threads add to.
enum class Elements { Uniform, Own, Loaded, LoadedAndMixed };

/// Lets the active threads of a warp add to `elements` elements.
Warp add(unsigned elements, uint32_t active, Elements kind = Elements::Uniform,
         bool combines = true, bool hasFew = false) {
  bool isLoaded = kind != Elements::Uniform && kind != Elements::Own;
  InitializeAllTargetInfos();
  InitializeAllTargets();
  InitializeAllTargetMCs();
  LLVMContext context;
  SMDiagnostic error;
  std::string text = "define void @f(";
  for (unsigned i = 0; i < elements; ++i)
    text += (i ? ", ptr %" : "ptr %") + std::string(isLoaded ? "q" : "p") +
            std::to_string(i) + ", float %v" + std::to_string(i);
  text += ") {\n";
  for (unsigned i = 0; isLoaded && i < elements; ++i)
    text += "  %p" + std::to_string(i) + " = load ptr, ptr %q" +
            std::to_string(i) + "\n";
  for (unsigned i = 0; i < elements; ++i)
    text += "  %o" + std::to_string(i) + " = atomicrmw fadd ptr %p" +
            std::to_string(i) + ", float %v" + std::to_string(i) +
            " syncscope(\"device\") monotonic" +
            (isLoaded ? ", !noalias !0\n" : "\n");
  text += "  ret void\n}\n"
          "!0 = !{!1}\n!1 = distinct !{!1, !2}\n!2 = distinct !{!2}\n";
  std::unique_ptr<Module> module = parseAssemblyString(text, error, context);
  Warp result;
  EXPECT_TRUE(module) << error.getMessage().str();
  if (!module)
    return result;
  Triple triple("nvptx64-nvidia-cuda");
  module->setTargetTriple(triple);
  Function &function = *module->getFunction("f");
  // The parameters of a kernel are the same for all threads.
  if (kind == Elements::Uniform)
    function.setCallingConv(CallingConv::PTX_Kernel);
  std::string message;
  const Target *target = TargetRegistry::lookupTarget(triple, message);
  EXPECT_TRUE(target) << message;
  std::unique_ptr<TargetMachine> machine(target->createTargetMachine(
      triple, "sm_90", "+ptx80", TargetOptions(), std::nullopt));
  if (hasFew)
    function.addFnAttr(runtime::kFewIterationsAttrName);
  runPass(function, AggregateAtomics(combines), machine.get());
  if (hasFew) {
    // The function may become part of a program, which has any number of
    // threads.
    function.removeFnAttr(runtime::kFewIterationsAttrName);
    runPass(function, AggregateAtomics(combines), machine.get());
  }
  EXPECT_FALSE(verifyFunction(function, &errs()));

  std::vector<std::string> names;
  std::map<std::string, double> expected;
  for (unsigned i = 0; i < elements; ++i) {
    names.push_back("element " + std::to_string(i));
    Values numbers, own;
    numbers.fill(i);
    // One thread adds to a different element than the other threads.
    if (kind == Elements::LoadedAndMixed)
      numbers[7] = elements - 1 - i;
    for (unsigned lane = 0; lane < warp; ++lane) {
      own[lane] = double((lane * 37 + i * 101) % 64);
      if (active >> lane & 1)
        expected["element " +
                 std::to_string(static_cast<unsigned>(numbers[lane]))] +=
            own[lane];
    }
    result.values[function.getArg(2 * i)] = numbers;
    result.values[function.getArg(2 * i + 1)] = own;
  }
  result.run(function.getEntryBlock(), active, names);
  EXPECT_EQ(result.memory, expected)
      << elements << " elements, threads " << active;
  return result;
}
} // namespace

TEST(AggregateAtomics, AFullWarpAddsOnceToEachElement) {
  for (unsigned elements : {2u, 3u, 5u, 7u, 16u, 17u, 31u, 32u}) {
    Warp result = add(elements, ~0u);
    EXPECT_EQ(result.additions, elements);
  }
  EXPECT_EQ(add(32, ~0u).exchanges, 31u);
}

TEST(AggregateAtomics, MoreElementsThanThreads) {
  EXPECT_EQ(add(70, ~0u).additions, 70u);
}

TEST(AggregateAtomics, TheFirstThreadsAddOnceToEachElement) {
  for (unsigned threads : {1u, 2u, 13u, 29u, 31u})
    EXPECT_EQ(add(6, (1u << threads) - 1).additions, 6u);
}

TEST(AggregateAtomics, OtherThreadsAddForThemselves) {
  EXPECT_EQ(add(3, 0x80000001u).additions, 6u);
  EXPECT_EQ(add(3, 0xfffffffeu).additions, 93u);
}

TEST(AggregateAtomics, ASingleElementOrOthersInEachThreadStay) {
  EXPECT_EQ(add(1, ~0u).additions, warp);
  EXPECT_EQ(add(4, ~0u, Elements::Own).additions, 4 * warp);
}

TEST(AggregateAtomics, ElementsThatDataChooseAreCompared) {
  for (unsigned elements : {1u, 2u}) {
    EXPECT_EQ(add(elements, ~0u, Elements::Loaded).additions, elements);
    EXPECT_EQ(add(elements, 0x1fffu, Elements::Loaded).additions, elements);
    EXPECT_EQ(add(elements, 0x80000001u, Elements::Loaded).additions,
              2 * elements);
  }
  EXPECT_EQ(add(2, ~0u, Elements::LoadedAndMixed).additions, 2 * warp);
  // The thread with a different element is inactive.
  EXPECT_EQ(add(2, 0x7fu, Elements::LoadedAndMixed).additions, 2u);
}

TEST(AggregateAtomics, ManyElementsThatDataChooseStay) {
  EXPECT_EQ(add(3, ~0u, Elements::Loaded).additions, 3 * warp);
  EXPECT_EQ(add(1, ~0u, Elements::Loaded, /*combines=*/false).additions, warp);
}

TEST(AggregateAtomics, FewIterationsAddApart) {
  Warp few = add(4, 0xffu, Elements::Uniform, /*combines=*/true,
                 /*hasFew=*/true);
  EXPECT_EQ(few.additions, 4u * 8u);
  EXPECT_EQ(few.exchanges, 0u);
}
