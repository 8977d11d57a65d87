// RUN: tai-opt %s --tai-convert-to-llvm | FileCheck %s

// Values that a loop carries do not wait for the flag of `break`.

// The next index does not wait for the division. The loop also carries the
// index at which it stops.
// CHECK-LABEL: llvm.func @divisor(
//       CHECK:   ^bb1(%[[A:.+]]: i32, %[[F:.+]]: i1, %[[K:.+]]: i32):
//       CHECK:   ^bb6(%[[I:.+]]: i32, %{{.+}}: i1, %{{.+}}: i32):
//       CHECK:     %[[STOP:.+]] = llvm.icmp "eq"
//       CHECK:     %[[NEXT:.+]] = llvm.add %[[I]]
//       CHECK:     llvm.br ^bb1(%[[NEXT]], %[[STOP]], %[[I]] : i32, i1, i32)
//       CHECK:     %[[R:.+]] = llvm.select %[[F]], %[[K]], %[[A]]
//       CHECK:     llvm.return %[[R]]
llvm.func @divisor(%n: i32) -> i32 attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : i32
  %c1 = arith.constant 1 : i32
  %c2 = arith.constant 2 : i32
  %false = arith.constant false
  %true = arith.constant true
  %r:2 = scf.while (%i = %c2, %found = %false) : (i32, i1) -> (i32, i1) {
    %more = scf.if %found -> (i1) {
      scf.yield %false : i1
    } else {
      %square = arith.muli %i, %i : i32
      %below = arith.cmpi sle, %square, %n : i32
      scf.yield %below : i1
    }
    scf.condition(%more) %i, %found : i32, i1
  } do {
  ^bb0(%i: i32, %found: i1):
    %rest = arith.remui %n, %i : i32
    %divides = arith.cmpi eq, %rest, %c0 : i32
    %stop = arith.select %divides, %true, %found : i1
    %next = scf.if %stop -> (i32) {
      scf.yield %i : i32
    } else {
      %following = arith.addi %i, %c1 : i32
      scf.yield %following : i32
    }
    scf.yield %next, %stop : i32, i1
  }
  llvm.return %r#0 : i32
}

// Nothing reads the index after the loop.
// CHECK-LABEL: llvm.func @contains(
//       CHECK:   ^bb2(%[[I:.+]]: i32, %{{.+}}: i1):
//       CHECK:     %[[STOP:.+]] = llvm.icmp "eq"
//       CHECK:     %[[NEXT:.+]] = llvm.add %[[I]]
//       CHECK:     llvm.br ^bb1(%[[NEXT]], %[[STOP]] : i32, i1)
llvm.func @contains(%p: !llvm.ptr, %n: i32) -> i1 attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : i32
  %c1 = arith.constant 1 : i32
  %false = arith.constant false
  %true = arith.constant true
  %r:2 = scf.while (%i = %c0, %found = %false) : (i32, i1) -> (i32, i1) {
    %below = arith.cmpi slt, %i, %n : i32
    %running = arith.xori %found, %true : i1
    %more = arith.andi %below, %running : i1
    scf.condition(%more) %i, %found : i32, i1
  } do {
  ^bb0(%i: i32, %found: i1):
    %at = llvm.getelementptr %p[%i] : (!llvm.ptr, i32) -> !llvm.ptr, i32
    %v = llvm.load %at : !llvm.ptr -> i32
    %stop = arith.cmpi eq, %v, %c0 : i32
    %following = arith.addi %i, %c1 : i32
    %next = arith.select %stop, %i, %following : i32
    scf.yield %next, %stop : i32, i1
  }
  llvm.return %r#1 : i1
}

// A load must not run once the flag is set.
// CHECK-LABEL: llvm.func @list(
//       CHECK:     llvm.cond_br %{{.+}}, ^bb3, ^bb4
//       CHECK:   ^bb4:
//       CHECK:     llvm.load
//       CHECK:     llvm.br ^bb5
//       CHECK:   ^bb5(%[[NEXT:.+]]: i32):
//       CHECK:     llvm.br ^bb1(%[[NEXT]], %{{.+}} : i32, i1)
llvm.func @list(%p: !llvm.ptr, %n: i32) -> i32 attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : i32
  %false = arith.constant false
  %true = arith.constant true
  %r:2 = scf.while (%i = %c0, %found = %false) : (i32, i1) -> (i32, i1) {
    %running = arith.xori %found, %true : i1
    scf.condition(%running) %i, %found : i32, i1
  } do {
  ^bb0(%i: i32, %found: i1):
    %stop = arith.cmpi eq, %i, %n : i32
    %next = scf.if %stop -> (i32) {
      scf.yield %i : i32
    } else {
      %at = llvm.getelementptr %p[%i] : (!llvm.ptr, i32) -> !llvm.ptr, i32
      %following = llvm.load %at : !llvm.ptr -> i32
      scf.yield %following : i32
    }
    scf.yield %next, %stop : i32, i1
  }
  llvm.return %r#0 : i32
}

// The flag does not end the loop.
// CHECK-LABEL: llvm.func @goes_on(
//       CHECK:     %[[STOP:.+]] = llvm.icmp "eq"
//       CHECK:     %[[NEXT:.+]] = llvm.select %[[STOP]]
//       CHECK:     llvm.br ^bb1(%[[NEXT]], %[[STOP]] : i32, i1)
llvm.func @goes_on(%n: i32) -> i32 attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : i32
  %c1 = arith.constant 1 : i32
  %false = arith.constant false
  %r:2 = scf.while (%i = %c0, %flag = %false) : (i32, i1) -> (i32, i1) {
    %below = arith.cmpi slt, %i, %n : i32
    scf.condition(%below) %i, %flag : i32, i1
  } do {
  ^bb0(%i: i32, %flag: i1):
    %even = arith.remui %n, %i : i32
    %stop = arith.cmpi eq, %even, %c0 : i32
    %following = arith.addi %i, %c1 : i32
    %next = arith.select %stop, %c1, %following : i32
    scf.yield %next, %stop : i32, i1
  }
  llvm.return %r#0 : i32
}
