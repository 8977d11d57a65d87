//===- TaiAttrs.td - Attributes of the tai dialect ---------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAIATTRS_TD
#define TAI_DIALECT_TAI_IR_TAIATTRS_TD

include "mlir/IR/AttrTypeBase.td"
include "mlir/IR/EnumAttr.td"
include "tai/Dialect/Tai/IR/TaiBase.td"

def Tai_AtomicKind : I32EnumAttr<"AtomicKind", "read-modify-write operation", [
    I32EnumAttrCase<"Add", 0, "add">, I32EnumAttrCase<"Sub", 1, "sub">,
    I32EnumAttrCase<"Mul", 2, "mul">, I32EnumAttrCase<"Min", 3, "min">,
    I32EnumAttrCase<"Max", 4, "max">, I32EnumAttrCase<"And", 5, "and">,
    I32EnumAttrCase<"Or", 6, "or">, I32EnumAttrCase<"Xor", 7, "xor">,
    I32EnumAttrCase<"MinU", 8, "minu">, I32EnumAttrCase<"MaxU", 9, "maxu">]> {
  let cppNamespace = "::mlir::tai";
  let genSpecializedAttr = 0;
}
def Tai_AtomicKindAttr
    : EnumAttr<Tai_Dialect, Tai_AtomicKind, "atomic_kind"> {
  let assemblyFormat = "$value";
}

def Tai_ReductionForm
    : I32EnumAttr<"ReductionForm", "where the updates of a loop go", [
    I32EnumAttrCase<"Register", 0, "register">,
    I32EnumAttrCase<"Buffer", 1, "buffer">,
    I32EnumAttrCase<"Fixed", 2, "fixed">]> {
  let cppNamespace = "::mlir::tai";
  let genSpecializedAttr = 0;
}

def Tai_SumDigits : I32EnumAttr<"SumDigits", "the numbers that hold a sum", [
    I32EnumAttrCase<"Own", 0, "own">, I32EnumAttrCase<"Wide", 1, "wide">,
    I32EnumAttrCase<"Pair", 2, "pair">]> {
  let cppNamespace = "::mlir::tai";
  let genSpecializedAttr = 0;
}

def Tai_ReductionOrder
    : I32EnumAttr<"ReductionOrder", "in which order a sum adds its terms", [
    I32EnumAttrCase<"Any", 0, "any">,
    I32EnumAttrCase<"Iterations", 1, "iterations">,
    I32EnumAttrCase<"Lanes", 2, "lanes">,
    I32EnumAttrCase<"Common", 3, "common">]> {
  let cppNamespace = "::mlir::tai";
  let genSpecializedAttr = 0;
}

/// Describes how a parallel loop performs an update of shared memory.
def Tai_ReductionAttr : AttrDef<Tai_Dialect, "Reduction"> {
  let mnemonic = "reduction";
  let summary = "how a parallel loop does an update";
  let description = [{
    `#tai.reduction<register own any block 2048>` and
    `#tai.reduction<buffer wide any buffer 0>`; `tai-relax-atomics` chooses.

    * `form`: a sum in a `register` of each partition or thread, where all
      iterations update one element; a `buffer` beside the field, with the
      number `buffer` in the loop; on a GPU, sums in `fixed` point, which have
      such a number as well.
    * `digits`: the type of the field (`own`; f32 for sums of 16-bit floats);
      a type with more digits, rounded once (`wide`); an f64 with the sum of its
      rounding errors (`pair`).
    * `order` of the terms: `any`; that of `iterations` in each partition;
      `lanes`, of which a loop has a fixed number whatever the number of
      threads; `common`, such lanes with the same iterations on all targets.
    * `block`: after so many iterations a sum in its own digits is added to a
      total of f64, or the terms of a pair, stored until then, are summed.
  }];
  let parameters = (ins
    EnumParameter<Tai_ReductionForm>:$form,
    EnumParameter<Tai_SumDigits>:$digits,
    EnumParameter<Tai_ReductionOrder>:$order,
    DefaultValuedParameter<"int64_t", "0">:$block,
    OptionalParameter<"std::optional<int64_t>">:$buffer
  );
  let assemblyFormat = [{
    `<` $form $digits $order (`block` $block^)? (`buffer` $buffer^)? `>`
  }];
  let genVerifyDecl = 1;
  let extraClassDeclaration = [{
    /// This attribute with `buffer` as the number of its buffer.
    ReductionAttr withBuffer(int64_t buffer) {
      return get(getContext(), getForm(), getDigits(), getOrder(), getBlock(),
                 buffer);
    }
  }];
}

def Tai_LoopOrder : I32EnumAttr<"LoopOrder", "what a result may depend on", [
    I32EnumAttrCase<"Fixed", 0, "fixed">,
    I32EnumAttrCase<"Common", 1, "common">]> {
  let cppNamespace = "::mlir::tai";
  let genSpecializedAttr = 0;
}
def Tai_LoopOrderAttr : EnumAttr<Tai_Dialect, Tai_LoopOrder, "loop_order"> {
  let assemblyFormat = "`<` $value `>`";
}

def Tai_CheckpointKind
    : I32EnumAttr<"CheckpointKind", "how a tape recomputes values", [
    I32EnumAttrCase<"Periodic", 1, "periodic">,
    I32EnumAttrCase<"Binomial", 2, "binomial">,
    I32EnumAttrCase<"Mixed", 3, "mixed">]> {
  let cppNamespace = "::mlir::tai";
  let genSpecializedAttr = 0;
}

/// Describes how a tape trades recomputation for saved values.
def Tai_CheckpointAttr : AttrDef<Tai_Dialect, "Checkpoint"> {
  let mnemonic = "checkpoint";
  let summary = "how a tape trades recomputation for saved values";
  let description = [{
    `#tai.checkpoint<mixed snapshots 8 budget 1000000>`.

    * `periodic`: snapshots at even distances, and saved values between two of
      them; `binomial`: snapshots alone; `mixed`: as `periodic` where the values
      between two snapshots fit into the budget.
    * `snapshots`: their maximum number; by default about the square root of the
      number of launches.
    * `budget`: the maximum of bytes in snapshots and saved values; by default
      there is none.
  }];
  let parameters = (ins
    EnumParameter<Tai_CheckpointKind>:$kind,
    DefaultValuedParameter<"int64_t", "0">:$snapshots,
    DefaultValuedParameter<"int64_t", "0">:$budget
  );
  let assemblyFormat = [{
    `<` $kind (`snapshots` $snapshots^)? (`budget` $budget^)? `>`
  }];
  let genVerifyDecl = 1;
}

def Tai_FieldUse : I32EnumAttr<"FieldUse", "how a kernel uses a field", [
    I32EnumAttrCase<"Read", 0, "read">, I32EnumAttrCase<"Write", 1, "write">,
    I32EnumAttrCase<"Accumulate", 2, "accumulate">]> {
  let cppNamespace = "::mlir::tai";
  let genSpecializedAttr = 0;
}

/// Describes how a kernel accesses one field.
def Tai_AccessAttr : AttrDef<Tai_Dialect, "Access"> {
  let mnemonic = "access";
  let summary = "one access of a kernel to a field";
  let description = [{
    `#tai.access<read @x, affine_map<(d0)[s0] -> (s0 - 1, d0)>>`: `kind` is one
    of `read`, `write`, `accumulate`; `map`, where the indices are affine, maps
    the loop indices of the enclosing loops (dimensions) and the integer
    arguments of the kernel (symbols) to the indices of the field.
  }];
  let parameters = (ins
    EnumParameter<Tai_FieldUse>:$kind,
    "::mlir::FlatSymbolRefAttr":$field,
    OptionalParameter<"::mlir::AffineMapAttr">:$map
  );
  let assemblyFormat = "`<` $kind $field (`,` $map^)? `>`";
}

#endif // TAI_DIALECT_TAI_IR_TAIATTRS_TD
